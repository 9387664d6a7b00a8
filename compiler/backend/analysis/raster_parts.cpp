// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/analysis/raster_parts.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "compiler/backend/analysis/form.h"
#include "compiler/backend/bundle/entries.h"
#include "compiler/ir/raster.h"

namespace dr::backend {

using ir::Graph;
using ir::Op;
using ir::OpKind;
using ir::ValueId;

namespace {

constexpr int kShiftOfWord = std::countr_zero(static_cast<uint32_t>(bundle::kBitsOfWord));

// Whether a comparison of a face with a constant tells -1 from the others and no more.
bool tells_presence(const Graph& graph, const Op& op, ValueId face) {
  const auto is_constant = [&](size_t k, double number) { return Form(graph).is_number(op.operands[k], number); };
  const bool first = op.operands[0] == face;
  if (op.kind == OpKind::Less) return first ? is_constant(1, 0) : is_constant(0, -1);
  if (op.kind == OpKind::LessEqual) return first ? is_constant(1, -1) : is_constant(0, 0);
  return op.kind == OpKind::Equal && is_constant(first ? 1 : 0, -1);
}

// Whether a step gives it away as it is.
bool is_result(const Graph& graph, ValueId v) {
  const auto is_it = [&](const auto& named) { return named.value == v; };
  return std::ranges::any_of(graph.steps, [&](const ir::Step& step) {
    return std::ranges::any_of(step.outputs, is_it) || std::ranges::any_of(step.updates, is_it);
  });
}

bool presence_alone(const Graph& graph, ValueId face, ir::RegionId region) {
  for (const ir::OpId id : graph.region(region).ops) {
    const Op& op = graph.op(id);
    const auto uses = std::ranges::count(op.operands, face);
    // What moves faces gives those that are asked for, or 0 where there is no element.
    const bool moves =
        op.kind == OpKind::Gather ? op.operands[0] == face : op.kind == OpKind::Select && op.operands[0] != face;
    if (uses > 0 && !tells_presence(graph, op, face) &&
        !(uses == 1 && moves && !is_result(graph, op.results[0]) && presence_alone(graph, op.results[0], graph.root())))
      return false;
    for (const ir::RegionId inner : op.regions)
      if (!presence_alone(graph, face, inner)) return false;
  }
  return std::ranges::count(graph.region(region).yields, face) == 0;
}

bool is_surely_number(const Graph& graph, ValueId v) {
  if (!graph.value(v).op.valid()) return false;
  const Op& op = graph.op(graph.value(v).op);
  const auto is = [&](size_t k) { return is_surely_number(graph, op.operands[k]); };
  if (op.kind == OpKind::Const) return std::ranges::none_of(op.attrs.floats, [](double x) { return std::isnan(x); });
  if (op.kind == OpKind::Max || op.kind == OpKind::Min) return is(0) || is(1);
  return op.kind == OpKind::Clamp && is(1) && is(2);
}

bool is_used(const Graph& graph, ValueId v, ir::RegionId region) {
  return std::ranges::any_of(graph.region(region).ops,
                             [&](ir::OpId id) {
                               const Op& op = graph.op(id);
                               return std::ranges::count(op.operands, v) > 0 ||
                                      std::ranges::any_of(op.regions,
                                                          [&](ir::RegionId inner) { return is_used(graph, v, inner); });
                             }) ||
         std::ranges::count(graph.region(region).yields, v) > 0;
}

}  // namespace

ir::Extent bits_extent(const ir::Extent& pixels) {
  return {(pixels.w + ir::Dim(bundle::kBitsOfWord - 1)).divided_by(bundle::kBitsOfWord), pixels.h, pixels.l};
}

bool is_rows_of(const Graph& graph, ValueId value, ValueId face) {
  const Form form(graph);
  const ir::ValueInfo& info = graph.value(value);
  const ir::Extent& pixels = graph.value(face).extent;
  const Op* sum = form.made_by(value, OpKind::Reduce);
  if (sum == nullptr || sum->results.size() != 1 || sum->attrs.yields[0] != ir::Yield::Sum || info.type != ir::kUint ||
      info.extent != bits_extent(pixels))
    return false;
  const ir::Region& body = graph.region(sum->regions[0]);
  const ValueId x = body.params[0];
  const auto is_bits = [&](ValueId v) { return form.is_number(v, bundle::kBitsOfWord); };
  const auto is_across = [&](ValueId v) { return form.is_place(v, 0); };
  const auto is_x = [&](ValueId v) { return v == x; };
  const auto is_begin = [&](ValueId v) { return form.is_both(v, OpKind::Mul, is_bits, is_across); };
  const auto is_rest = [&](ValueId v) {
    const Op* op = form.made_by(v, OpKind::Sub);
    return op != nullptr && form.is_extent(op->operands[0], pixels.w) && is_begin(op->operands[1]);
  };
  if (!form.is_number(sum->operands[0], 0) || !form.is_both(sum->operands[1], OpKind::Min, is_bits, is_rest))
    return false;
  const Op* chosen = form.made_by(body.yields[0], OpKind::If);
  if (chosen == nullptr || chosen->results.size() != 1) return false;
  const ValueId bit = graph.region(chosen->regions[0]).yields[0], none = graph.region(chosen->regions[1]).yields[0];
  const Op* covered = form.made_by(chosen->operands[0], OpKind::LessEqual);
  if (covered == nullptr || !form.is_number(covered->operands[0], 0) || !form.is_number(none, 0)) return false;
  const Op* read = form.made_by(covered->operands[1], OpKind::Gather);
  const Op* place = read == nullptr ? nullptr : form.made_by(read->operands[1], OpKind::Compose);
  if (place == nullptr || read->operands[0] != face || place->operands.size() != 2 ||
      !form.is_both(place->operands[0], OpKind::Add, is_begin, is_x) || !form.is_place(place->operands[1], 1))
    return false;
  const Op* shifted = form.made_by(bit, OpKind::ShiftLeft);
  const Op* by = shifted == nullptr ? nullptr : form.made_by(shifted->operands[1], OpKind::Convert);
  return by != nullptr && form.is_number(shifted->operands[0], 1) && by->operands[0] == x;
}

std::optional<WantedPixels> wanted_pixels(const Graph& graph, const Op& op) {
  const Form form(graph);
  const ir::Region& keep = graph.region(op.regions[kKeep]);
  const ValueId p = keep.params.back();
  const Op* chosen = form.made_by(keep.yields[0], OpKind::If);
  if (chosen == nullptr || !form.is_number(graph.region(chosen->regions[1]).yields[0], 0)) return std::nullopt;
  const auto is_number = [&](double number) { return [=](ValueId v) { return form.is_number(v, number); }; };
  // Of the pixel that `p` is the middle of, the place on an axis.
  const auto is_place = [&](ValueId v, int axis) {
    const Op* part = form.made_by(v, OpKind::Extract);
    const Op* pixel = part == nullptr ? nullptr : form.made_by(part->operands[0], OpKind::Convert);
    return pixel != nullptr && part->attrs.ints[0] == axis && pixel->operands[0] == p;
  };
  const Op* read = nullptr;
  const auto is_shifted = [&](ValueId v) {
    const Op* shift = form.made_by(v, OpKind::ShiftRight);
    if (shift == nullptr) return false;
    read = form.made_by(shift->operands[0], OpKind::Gather);
    const Op* by = form.made_by(shift->operands[1], OpKind::Convert);
    return read != nullptr && by != nullptr &&
           form.is_both(
               by->operands[0], OpKind::BitAnd, [&](ValueId x) { return is_place(x, 0); },
               is_number(bundle::kBitsOfWord - 1));
  };
  const auto is_last_bit = [&](ValueId v) { return form.is_both(v, OpKind::BitAnd, is_shifted, is_number(1)); };
  if (!form.is_both(chosen->operands[0], OpKind::Equal, is_last_bit, is_number(1))) return std::nullopt;
  const Op* at = form.made_by(read->operands[1], OpKind::Compose);
  if (at == nullptr || at->operands.size() != 2 || !is_place(at->operands[1], 1)) return std::nullopt;
  const Op* word = form.made_by(at->operands[0], OpKind::ShiftRight);
  if (word == nullptr || !is_place(word->operands[0], 0) || !form.is_number(word->operands[1], kShiftOfWord))
    return std::nullopt;
  const ValueId bits = read->operands[0];
  const RasterParts parts = raster_parts(op);
  if (graph.value(bits).type != ir::kUint || graph.value(bits).extent != bits_extent(parts.extent()))
    return std::nullopt;
  return WantedPixels{bits, chosen->operands[0]};
}

bool has_depth_always(const Graph& graph, const Op& op) {
  return is_surely_number(graph, graph.region(op.regions[kDepth]).yields[0]);
}

bool uses_field(const Graph& graph, const Op& op, RasterRegion closure, size_t field) {
  return is_used(graph, graph.region(op.regions[closure]).params[field], op.regions[closure]);
}

std::set<ValueId> walked_record(const Graph& graph, const Op& op, bool depths) {
  const RasterParts parts = raster_parts(op);
  std::set<ValueId> out(parts.corners.begin(), parts.corners.end());
  for (size_t k = 0; k < parts.fields.size(); ++k)
    if ((depths && uses_field(graph, op, kDepth, k)) || uses_field(graph, op, kKeep, k) ||
        uses_field(graph, op, kTag, k))
      out.insert(parts.fields[k]);
  return out;
}

bool is_asked_for_presence(const Graph& graph, const Op& op) {
  return op.results.size() == 2 && !is_used(graph, op.results[1], graph.root()) &&
         presence_alone(graph, op.results[0], graph.root());
}

RasterParts raster_parts(const ir::Op& op) {
  RasterParts p;
  p.count = static_cast<size_t>(op.attrs.ints[0]);
  p.each = ir::results_a_rank(op.attrs);
  p.listed = ir::lists_faces(op.attrs);
  const auto fields = static_cast<size_t>(op.attrs.ints[1]), corners = static_cast<size_t>(op.attrs.ints[2]);
  p.fields.assign(op.operands.begin(), op.operands.begin() + static_cast<ptrdiff_t>(fields));
  p.corners.assign(op.operands.begin() + static_cast<ptrdiff_t>(fields),
                   op.operands.begin() + static_cast<ptrdiff_t>(fields + corners));
  p.cull = op.operands.back();
  p.w = op.attrs.dims[0];
  p.h = op.attrs.dims[1];
  p.l = op.attrs.dims[2];
  p.faces = op.attrs.dims[3];
  return p;
}

}  // namespace dr::backend
