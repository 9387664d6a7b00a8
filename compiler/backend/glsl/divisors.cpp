// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/glsl/divisors.h"

#include <algorithm>
#include <cmath>
#include <span>

#include "compiler/ops/op.h"

namespace dr::backend::glsl {

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
  switch (op.kind) {
    case OpKind::Const:  // known in every shader
      return std::find(op.attrs.floats.begin(), op.attrs.floats.end(), 0.0) != op.attrs.floats.end();
    case OpKind::Sqrt:
    case OpKind::InverseSqrt:
    case OpKind::Div: return !native;
    default: return is_known_to_driver(graph, v);
  }
}

bool is_moderate(const ir::Graph& graph, ValueId v) {
  constexpr double kLarge = 8e37;
  if (!graph.value(v).op.valid()) return false;
  const Op& op = graph.op(graph.value(v).op);
  const auto are_moderate = [&](std::span<const ValueId> values) {
    return std::ranges::all_of(values, [&](ValueId x) { return is_moderate(graph, x); });
  };
  if (ops::info(op.kind).moves) return are_moderate(op.operands);
  switch (op.kind) {
    case OpKind::Const: return std::ranges::all_of(op.attrs.floats, [](double x) { return std::abs(x) < kLarge; });
    case OpKind::DimValue:
    case OpKind::Sqrt:
    case OpKind::InverseSqrt: return true;
    case OpKind::Convert: return !graph.value(op.operands[0]).type.is_float();
    case OpKind::Select: return are_moderate(std::span(op.operands).subspan(1));
    default: return false;
  }
}

}  // namespace dr::backend::glsl
