// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/analysis/divisors.h"

#include <algorithm>
#include <cmath>
#include <span>

#include "compiler/ops/op.h"

namespace dr::backend {

using ir::Op;
using ir::OpKind;
using ir::ValueId;

namespace {

// Whether every lane of every run has the same number, known when the pipeline is made.
bool is_known_to_driver(const ir::Graph& graph, ValueId v) {
  if (!graph.value(v).op.valid()) return false;
  const Op& op = graph.op(graph.value(v).op);
  if (op.kind == OpKind::Const || op.kind == OpKind::DimValue) return true;
  return !op.operands.empty() && op.regions.empty() && ops::info(op.kind).glsl != nullptr &&
         std::all_of(op.operands.begin(), op.operands.end(), [&](ValueId x) { return is_known_to_driver(graph, x); });
}

}  // namespace

bool hide_as_divisor(const ir::Graph& graph, ValueId v, bool native) {
  if (!graph.value(v).op.valid()) return false;
  const Op& op = graph.op(graph.value(v).op);
  if (ops::info(op.kind).moves)
    return std::ranges::any_of(op.operands, [&](ValueId x) { return hide_as_divisor(graph, x, native); });
  if (op.kind == OpKind::Const)  // known in every shader
    return std::find(op.attrs.floats.begin(), op.attrs.floats.end(), 0.0) != op.attrs.floats.end();
  if (op.kind == OpKind::Sqrt || op.kind == OpKind::InverseSqrt || op.kind == OpKind::Div) return !native;
  return (native && !is_moderate(graph, v)) || is_known_to_driver(graph, v);
}

bool is_moderate(const ir::Graph& graph, ValueId v) {
  constexpr double kLarge = 8e37;
  if (!graph.value(v).op.valid()) return false;
  const Op& op = graph.op(graph.value(v).op);
  const auto are_moderate = [&](std::span<const ValueId> values) {
    return std::ranges::all_of(values, [&](ValueId x) { return is_moderate(graph, x); });
  };
  if (ops::info(op.kind).moves) return are_moderate(op.operands);
  if (op.kind == OpKind::Const)
    return std::ranges::all_of(op.attrs.floats, [](double x) { return std::abs(x) < kLarge; });
  if (op.kind == OpKind::DimValue || op.kind == OpKind::Sqrt || op.kind == OpKind::InverseSqrt) return true;
  if (op.kind == OpKind::Convert) return !graph.value(op.operands[0]).type.is_float();
  if (op.kind == OpKind::Select) return are_moderate(std::span(op.operands).subspan(1));
  return false;
}

}  // namespace dr::backend
