// SPDX-License-Identifier: Apache-2.0
// What a region of an If or Reduce yields for each result, taken apart. See graph.h for how yields combine.
#pragma once

#include <vector>

#include "compiler/ir/graph.h"

namespace dr::ir {

// Whether an op's results are combined out of what its regions yield.
inline bool combines_yields(OpKind kind) { return kind == OpKind::If || kind == OpKind::Reduce; }

// The elements that an op with regions runs them for.
inline Extent domain_of(const Op& op) { return {op.attrs.dims[0], op.attrs.dims[1], op.attrs.dims[2]}; }

// What a region yields for one result. `index` is valid for a Scatter of (index, value) only; a Scatter without one
// yields an accumulation of an inner op on.
struct Yielded {
  ValueId index;
  ValueId value;
};
// One entry a result of `op`, an If or Reduce of a verified graph, that `region` belongs to.
std::vector<Yielded> yielded(const Graph& graph, const Op& op, RegionId region);

}  // namespace dr::ir
