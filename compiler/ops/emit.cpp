// SPDX-License-Identifier: Apache-2.0
// Building graphs with inferred types.
#include "compiler/ops/emit.h"

namespace dr::ops {

namespace {

ir::Attrs with_dims(const Extent& extent, std::vector<int64_t> ints = {}) {
  ir::Attrs attrs;
  attrs.ints = std::move(ints);
  attrs.dims = {extent.w, extent.h, extent.l};
  return attrs;
}

ir::Attrs with_ints(std::vector<int64_t> ints) {
  ir::Attrs attrs;
  attrs.ints = std::move(ints);
  return attrs;
}

}  // namespace

ValueId emit(Builder& b, OpKind kind, std::vector<ValueId> operands, ir::Attrs attrs,
             std::vector<ir::RegionId> regions) {
  const std::vector<ValueId> results = emit_multi(b, kind, std::move(operands), std::move(attrs), std::move(regions));
  DR_ASSERT(results.size() == 1);
  return results[0];
}

std::vector<ValueId> emit_multi(Builder& b, OpKind kind, std::vector<ValueId> operands, ir::Attrs attrs,
                                std::vector<ir::RegionId> regions) {
  InferResult inferred = infer(b.graph(), kind, operands, attrs, regions);
  if (const auto* message = std::get_if<std::string>(&inferred)) {
    std::string types;
    for (const ValueId id : operands) {
      types += (types.empty() ? "" : ", ") + b.value(id).type.str() + b.value(id).extent.str();
    }
    DR_ICE("emitted " + std::string(ir::op_name(kind)) + "(" + types + "): " + *message);
  }
  auto& results = std::get<std::vector<ir::ResultType>>(inferred);
  // What a region scatters is an image only once the outermost op has collected it.
  const bool in_region = b.current_region() != b.graph().root();
  for (size_t k = 0; k < results.size() && k < attrs.yields.size(); ++k) {
    results[k].accumulation = in_region && attrs.yields[k] == ir::Yield::Scatter;
  }
  const ir::OpId op = b.add(kind, std::move(operands), results, std::move(attrs), std::move(regions));
  return b.graph().op(op).results;
}

ValueId constant(Builder& b, Type type, std::vector<double> components) {
  DR_ASSERT(components.size() == static_cast<size_t>(type.components()));
  ir::Attrs attrs;
  attrs.floats = std::move(components);
  const ir::ResultType result{.type = type, .extent = {}};
  const ir::OpId op = b.add(OpKind::Const, {}, {&result, 1}, std::move(attrs));
  return b.graph().op(op).results[0];
}

ValueId constant(Builder& b, Type type, double every_component) {
  return constant(b, type, std::vector<double>(static_cast<size_t>(type.components()), every_component));
}

ValueId dim_value(Builder& b, const Dim& dim) {
  ir::Attrs attrs;
  attrs.dims = {dim};
  return emit(b, OpKind::DimValue, {}, std::move(attrs));
}

ValueId coord(Builder& b, int axis, const Extent& extent) {
  return emit(b, OpKind::Coord, {}, with_dims(extent, {axis}));
}

ValueId add(Builder& b, ValueId x, ValueId y) { return emit(b, OpKind::Add, {x, y}); }
ValueId sub(Builder& b, ValueId x, ValueId y) { return emit(b, OpKind::Sub, {x, y}); }
ValueId mul(Builder& b, ValueId x, ValueId y) { return emit(b, OpKind::Mul, {x, y}); }
ValueId div(Builder& b, ValueId x, ValueId y) { return emit(b, OpKind::Div, {x, y}); }
ValueId neg(Builder& b, ValueId x) { return emit(b, OpKind::Neg, {x}); }

ValueId smul(Builder& b, ValueId g, ValueId x) {
  const Type g_type = b.value(g).type;
  const Type x_type = b.value(x).type;
  if (g_type.is_scalar() && x_type.is_vector()) g = splat(b, g, x_type.rows);
  if (x_type.is_scalar() && g_type.is_vector()) x = splat(b, x, g_type.rows);
  return emit(b, OpKind::SMul, {g, x});
}

ValueId select(Builder& b, ValueId c, ValueId x, ValueId y) { return emit(b, OpKind::Select, {c, x, y}); }

ValueId splat(Builder& b, ValueId scalar, int components) {
  if (components == 1) return scalar;
  return emit(b, OpKind::Splat, {scalar}, with_ints({components}));
}

ValueId extract(Builder& b, ValueId x, int index) {
  if (b.value(x).type.is_scalar()) {
    DR_ASSERT(index == 0);
    return x;
  }
  return emit(b, OpKind::Extract, {x}, with_ints({index}));
}

ValueId compose(Builder& b, std::vector<ValueId> parts, Type type) {
  if (type.is_scalar() && parts.size() == 1) return parts[0];
  return emit(b, OpKind::Compose, std::move(parts), with_ints({type.rows, type.cols}));
}

ValueId broadcast(Builder& b, ValueId x, const Extent& extent) {
  if (b.value(x).extent == extent) return x;
  return emit(b, OpKind::Broadcast, {x}, with_dims(extent));
}

ValueId reduce_to(Builder& b, ValueId x, const Extent& extent) {
  const Extent from = b.value(x).extent;
  std::vector<int64_t> axes;
  for (const auto axis : {&Extent::w, &Extent::h, &Extent::l})
    axes.push_back((from.*axis).is_one() || !(extent.*axis).is_one() ? 0 : 1);
  if (axes == std::vector<int64_t>{0, 0, 0}) return x;
  const Type type = b.value(x).type;
  if (!type.is_matrix()) return emit(b, OpKind::ReduceSum, {x}, with_ints(axes));
  std::vector<ValueId> columns;
  for (int k = 0; k < type.cols; ++k)
    columns.push_back(emit(b, OpKind::ReduceSum, {extract(b, x, k)}, with_ints(axes)));
  return compose(b, columns, type);
}

ValueId zero_like(Builder& b, ValueId x) { return constant(b, b.value(x).type, 0.0); }

}  // namespace dr::ops
