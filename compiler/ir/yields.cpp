// SPDX-License-Identifier: Apache-2.0
#include "compiler/ir/yields.h"

namespace dr::ir {

namespace {

// The states of the sweeps before this one.
size_t states_before(const Op& op, size_t sweep) {
  size_t count = 0;
  for (size_t k = 0; k < sweep; ++k) count += fold_states(op, k);
  return count;
}

}  // namespace

std::vector<Yielded> yielded(const Graph& graph, const Op& op, RegionId region) {
  const std::vector<ValueId>& values = graph.region(region).yields;
  std::vector<Yielded> result;
  size_t at = op.kind == OpKind::Fold && fold_sweeps(op) == 1 && fold_stops(op) ? 1 : 0;
  for (const Yield how : op.attrs.yields) {
    const bool pair = how == Yield::Scatter && !graph.value(values[at]).accumulation;
    const ValueId index = pair ? values[at++] : ValueId{};
    result.push_back({.index = index, .value = values[at++]});
  }
  DR_ASSERT(at == values.size());
  return result;
}

std::span<const ValueId> fold_starts(const Op& op, size_t sweep) {
  return std::span(op.operands).subspan(2 + states_before(op, sweep), fold_states(op, sweep));
}

std::span<const ValueId> fold_params(const Graph& graph, const Op& op, size_t sweep, size_t of) {
  const std::vector<ValueId>& params = graph.region(op.regions[sweep]).params;
  return std::span(params).subspan(1 + states_before(op, of), fold_states(op, of));
}

std::span<const ValueId> fold_next(const Graph& graph, const Op& op, size_t sweep) {
  const std::vector<ValueId>& yields = graph.region(op.regions[sweep]).yields;
  return std::span(yields).subspan(sweep == 0 && fold_stops(op) ? 1 : 0, fold_states(op, sweep));
}

ValueId fold_stop(const Graph& graph, const Op& op) {
  return fold_stops(op) ? graph.region(op.regions[0]).yields[0] : ValueId{};
}

}  // namespace dr::ir
