// SPDX-License-Identifier: Apache-2.0
// What a region of an If, Reduce or Fold yields for each result, taken apart. See graph.h for how yields combine.
#pragma once

#include <span>
#include <vector>

#include "compiler/ir/graph.h"

namespace dr::ir {

// Whether an op's results are combined out of what its regions yield.
inline bool combines_yields(OpKind kind) {
  return kind == OpKind::If || kind == OpKind::Reduce || kind == OpKind::Fold;
}

// Whether the regions of an op run once for each trip.
inline bool is_loop(OpKind kind) { return kind == OpKind::Reduce || kind == OpKind::Fold; }

// The elements that an op with regions runs them for.
inline Extent domain_of(const Op& op) { return {op.attrs.dims[0], op.attrs.dims[1], op.attrs.dims[2]}; }

// The regions that yield for the results: both of an If, the last of a Fold.
inline std::span<const RegionId> yielding_regions(const Op& op) {
  return op.kind == OpKind::Fold ? std::span(op.regions).last(1) : std::span(op.regions);
}

// What a region yields for one result. `index` is valid for a Scatter of (index, value) only; a Scatter without one
// yields an accumulation of an inner op on.
struct Yielded {
  ValueId index;
  ValueId value;
};
// One entry a result of `op`, which combines yields, of a verified graph; `region` is one of its yielding regions.
std::vector<Yielded> yielded(const Graph& graph, const Op& op, RegionId region);

// --- Fold ---

inline int64_t fold_bound(const Op& op) { return op.attrs.ints[0]; }
inline bool fold_stops(const Op& op) { return op.attrs.ints[1] != 0; }
inline size_t fold_sweeps(const Op& op) { return op.attrs.ints.size() - 2; }
inline size_t fold_states(const Op& op, size_t sweep) { return static_cast<size_t>(op.attrs.ints[2 + sweep]); }
// The states that a sweep starts with, among the op's operands.
std::span<const ValueId> fold_starts(const Op& op, size_t sweep);
// The parameters of a sweep's region that hold the states of another one that is no later than it.
std::span<const ValueId> fold_params(const Graph& graph, const Op& op, size_t sweep, size_t of);
// The states that a sweep's region yields.
std::span<const ValueId> fold_next(const Graph& graph, const Op& op, size_t sweep);
// The Bool after which no trip comes, or an invalid id.
ValueId fold_stop(const Graph& graph, const Op& op);

}  // namespace dr::ir
