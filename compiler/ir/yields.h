// SPDX-License-Identifier: Apache-2.0
// What a region of an If or Reduce yields for each result, taken apart. See graph.h for how yields combine.
#pragma once

#include <vector>

#include "compiler/ir/graph.h"

namespace dr::ir {

// What a region yields for one result. `index` is valid for a Scatter of (index, value) only; a Scatter without one
// yields an accumulation of an inner op on.
struct Yielded {
  ValueId index;
  ValueId value;
};
// One entry a result of `op`, an If or Reduce of a verified graph, that `region` belongs to.
std::vector<Yielded> yielded(const Graph& graph, const Op& op, RegionId region);

}  // namespace dr::ir
