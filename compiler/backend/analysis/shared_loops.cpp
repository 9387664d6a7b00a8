// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/analysis/shared_loops.h"

#include <algorithm>

#include "compiler/ir/yields.h"

namespace dr::backend {

using ir::Op;
using ir::OpKind;
using ir::Yield;

namespace {

bool has_loop(const ir::Graph& graph, ir::RegionId region) {
  return std::ranges::any_of(graph.region(region).ops, [&](ir::OpId id) {
    const Op& op = graph.op(id);
    return ir::is_loop(op.kind) ||
           std::ranges::any_of(op.regions, [&](ir::RegionId inner) { return has_loop(graph, inner); });
  });
}

}  // namespace

bool only_scatters(const ir::Graph& graph, const Op& op) {
  const auto scatters = [](Yield yield) { return yield == Yield::Scatter; };
  if (op.kind == OpKind::Reduce) return std::ranges::all_of(op.attrs.yields, scatters);
  if (op.kind != OpKind::Fold || ir::fold_sweeps(op) != 2 || ir::fold_stops(op) || ir::fold_states(op, 0) != 0)
    return false;
  const size_t states = ir::fold_states(op, 1);
  return std::ranges::all_of(std::span(op.attrs.yields).subspan(states), scatters) &&
         std::ranges::equal(ir::fold_next(graph, op, 1), ir::fold_params(graph, op, 1, 1));
}

bool have_loop_that_only_scatters(const ir::Graph& graph, std::span<const ir::OpId> ops) {
  return std::ranges::any_of(ops, [&](ir::OpId id) {
    const Op& op = graph.op(id);
    return only_scatters(graph, op) || std::ranges::any_of(op.regions, [&](ir::RegionId region) {
             return have_loop_that_only_scatters(graph, graph.region(region).ops);
           });
  });
}

bool combines_in_any_order(const ir::Graph& graph, const Op& op) {
  if (op.kind != OpKind::Reduce) return false;
  const auto combines = [](Yield yield) { return yield == Yield::Sum || yield == Yield::Min || yield == Yield::Max; };
  return std::ranges::all_of(op.attrs.yields, combines) &&
         std::ranges::all_of(op.results, [&](ir::ValueId v) { return graph.value(v).type.is_integer(); });
}

bool have_long_loop_in_any_order(const ir::Graph& graph, std::span<const ir::OpId> ops) {
  return std::ranges::any_of(ops, [&](ir::OpId id) {
    const Op& op = graph.op(id);
    if (ir::is_loop(op.kind)) return combines_in_any_order(graph, op) && has_loop(graph, op.regions[0]);
    return std::ranges::any_of(
        op.regions, [&](ir::RegionId region) { return have_long_loop_in_any_order(graph, graph.region(region).ops); });
  });
}

}  // namespace dr::backend
