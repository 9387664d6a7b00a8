// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/glsl/inside.h"

#include <algorithm>
#include <iterator>
#include <span>

#include "compiler/backend/schedule/trips.h"
#include "compiler/ir/dim_bound.h"

namespace dr::backend::glsl {

using ir::Dim;
using ir::Op;
using ir::OpKind;
using ir::ValueId;

namespace {

// Whether an integer is made in a way that its bounds hold for 32 bits too: sums and products may wrap on the way, as
// long as nothing but sums and products follows.
struct Allowed {
  bool product = true;
  bool any_word = true;  // an integer that may be any: no sum, which would wrap, follows before it is clamped
};
bool holds_in_words(const ir::Graph& graph, ValueId v, Allowed allowed, int& left) {
  if (--left < 0) return false;
  const ir::ValueInfo& info = graph.value(v);
  if (!info.op.valid()) return true;
  const Op& op = graph.op(info.op);
  static constexpr OpKind kEnds[] = {OpKind::Const, OpKind::DimValue, OpKind::Coord};
  static constexpr OpKind kBounds[] = {OpKind::Min, OpKind::Max, OpKind::Clamp, OpKind::Div, OpKind::Mod};
  static constexpr OpKind kOthers[] = {OpKind::Add,     OpKind::Sub,   OpKind::Compose,
                                       OpKind::Extract, OpKind::Splat, OpKind::Broadcast};
  const auto is_one_of = [&](const auto& kinds) { return std::ranges::find(kinds, op.kind) != std::end(kinds); };
  if (is_one_of(kEnds)) return true;
  // Of a float it is the nearest one that words hold, and 0 of a NaN.
  if (op.kind == OpKind::Convert && graph.value(op.operands[0]).type.is_float()) return allowed.any_word;
  const bool bounds = is_one_of(kBounds), multiplies = op.kind == OpKind::Mul && allowed.product;
  if (!bounds && !multiplies && !is_one_of(kOthers)) return false;
  allowed.product = allowed.product && !bounds;
  if (op.kind == OpKind::Clamp) {
    Allowed clamped = allowed;
    clamped.any_word = true;
    if (!holds_in_words(graph, op.operands[0], clamped, left)) return false;
  }
  if (op.kind == OpKind::Add || op.kind == OpKind::Sub || multiplies) allowed.any_word = false;
  return std::ranges::all_of(std::span(op.operands).subspan(op.kind == OpKind::Clamp ? 1 : 0),
                             [&](ValueId x) { return holds_in_words(graph, x, allowed, left); });
}

// Of one component of an integer.
Bounds bounds_of_component(const ir::Graph& graph, ValueId v, int c, int depth) {
  constexpr int kDeepest = 8;
  const ir::ValueInfo& info = graph.value(v);
  if (!info.op.valid() || info.type.is_scalar() || depth > kDeepest) return bounds_of(graph, v);
  const Op& op = graph.op(info.op);
  const auto of = [&](size_t k) { return bounds_of_component(graph, op.operands[k], c, depth + 1); };
  if (op.kind == OpKind::Compose) return bounds_of(graph, op.operands[static_cast<size_t>(c)]);
  if (op.kind == OpKind::Broadcast) return of(0);
  if (op.kind == OpKind::Const && op.attrs.floats.size() > static_cast<size_t>(c)) {
    const Dim x(static_cast<int64_t>(op.attrs.floats[static_cast<size_t>(c)]));
    return {x, x};
  }
  if (op.kind == OpKind::Add || op.kind == OpKind::Sub) {
    const Bounds a = of(0), b = of(1);
    if (!a.low || !a.high || !b.low || !b.high) return {};
    if (op.kind == OpKind::Add) return {*a.low + *b.low, *a.high + *b.high};
    return {*a.low - *b.high, *a.high - *b.low};
  }
  return bounds_of(graph, v);
}

}  // namespace

bool is_inside(const ir::Graph& graph, const Op& gather) {
  const ir::Extent& image = graph.value(gather.operands[0]).extent;
  const ValueId index = gather.operands[1];
  int left = 64;
  if (!holds_in_words(graph, index, {}, left)) return false;
  const Dim* const sizes[] = {&image.w, &image.h, &image.l};
  for (int c = 0; c < graph.value(index).type.rows; ++c) {
    const Bounds bounds = bounds_of_component(graph, index, c, 0);
    if (!bounds.low || !bounds.high || !ir::never_above_zero(Dim(0) - *bounds.low)) return false;
    if (!ir::never_above_zero(*bounds.high - (*sizes[c] - Dim(1)))) return false;
  }
  // Of fewer components: in the element's own layer.
  return graph.value(index).type.rows == 3 || image.l.is_one() || graph.value(gather.results[0]).extent.l == image.l;
}

}  // namespace dr::backend::glsl
