// SPDX-License-Identifier: Apache-2.0
// Building graphs with inferred types: what lowering and adjoint rules write ops with. A type error here is an
// internal error; callers that serve users check first.
#pragma once

#include "compiler/ir/graph.h"
#include "compiler/ops/op.h"

namespace dr::ops {

using ir::Builder;
using ir::Dim;
using ir::Extent;
using ir::OpKind;
using ir::Type;
using ir::ValueId;

// Any op with one result.
ValueId emit(Builder& b, OpKind kind, std::vector<ValueId> operands, ir::Attrs attrs = {},
             std::vector<ir::RegionId> regions = {});
// Any op; the results in order.
std::vector<ValueId> emit_multi(Builder& b, OpKind kind, std::vector<ValueId> operands, ir::Attrs attrs = {},
                                std::vector<ir::RegionId> regions = {});

ValueId constant(Builder& b, Type type, std::vector<double> components);  // extent 1
ValueId constant(Builder& b, Type type, double every_component);
ValueId dim_value(Builder& b, const Dim& dim);
ValueId coord(Builder& b, int axis, const Extent& extent);

ValueId add(Builder& b, ValueId x, ValueId y);
ValueId sub(Builder& b, ValueId x, ValueId y);
ValueId mul(Builder& b, ValueId x, ValueId y);
ValueId div(Builder& b, ValueId x, ValueId y);
ValueId neg(Builder& b, ValueId x);
// Scalars splat to the vector's size as needed: smul(vec3 g, float x).
ValueId smul(Builder& b, ValueId g, ValueId x);
ValueId select(Builder& b, ValueId c, ValueId x, ValueId y);
ValueId splat(Builder& b, ValueId scalar, int components);  // as is for 1
ValueId extract(Builder& b, ValueId x, int index);
ValueId compose(Builder& b, std::vector<ValueId> parts, Type type);
ValueId broadcast(Builder& b, ValueId x, const Extent& extent);  // as is when the extent is that already
// Sum over the axes on which x is not 1 but `extent` is: the adjoint of stretching.
ValueId reduce_to(Builder& b, ValueId x, const Extent& extent);
ValueId zero_like(Builder& b, ValueId x);  // constant zero of x's type, extent 1

}  // namespace dr::ops
