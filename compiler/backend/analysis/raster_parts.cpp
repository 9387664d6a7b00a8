// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/analysis/raster_parts.h"

#include <algorithm>
#include <cmath>

#include "compiler/ir/raster.h"

namespace dr::backend {

using ir::Graph;
using ir::Op;
using ir::OpKind;
using ir::ValueId;

namespace {

// Whether a comparison of a face with a constant tells -1 from the others and no more.
bool tells_presence(const Graph& graph, const Op& op, ValueId face) {
  const auto is_constant = [&](size_t k, double number) {
    const Op& by = graph.op(graph.value(op.operands[k]).op);
    return by.kind == OpKind::Const && by.attrs.floats.size() == 1 && by.attrs.floats[0] == number;
  };
  const bool first = op.operands[0] == face;
  if (op.kind == OpKind::Less) return first ? is_constant(1, 0) : is_constant(0, -1);
  if (op.kind == OpKind::LessEqual) return first ? is_constant(1, -1) : is_constant(0, 0);
  return op.kind == OpKind::Equal && is_constant(first ? 1 : 0, -1);
}

bool presence_alone(const Graph& graph, ValueId face, ir::RegionId region) {
  for (const ir::OpId id : graph.region(region).ops) {
    const Op& op = graph.op(id);
    const auto uses = std::ranges::count(op.operands, face);
    // What moves faces gives those that are asked for, or 0 where there is no element.
    const bool moves =
        op.kind == OpKind::Gather ? op.operands[0] == face : op.kind == OpKind::Select && op.operands[0] != face;
    if (uses > 0 && !tells_presence(graph, op, face) &&
        !(uses == 1 && moves && presence_alone(graph, op.results[0], graph.root())))
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

bool has_depth_always(const Graph& graph, const Op& op) {
  return is_surely_number(graph, graph.region(op.regions[kDepth]).yields[0]);
}

bool is_asked_for_presence(const Graph& graph, const Op& op) {
  return op.results.size() == 2 && !is_used(graph, op.results[1], graph.root()) &&
         presence_alone(graph, op.results[0], graph.root());
}

RasterParts raster_parts(const ir::Op& op) {
  RasterParts p;
  p.count = static_cast<size_t>(op.attrs.ints[0]);
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
