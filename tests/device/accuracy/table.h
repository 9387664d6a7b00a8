// SPDX-License-Identifier: Apache-2.0
// What the accuracy table is written with: operands, scales and cases of the usual forms.
#pragma once

#include <cfloat>

#include "compiler/ops/emit.h"
#include "compiler/ops/op.h"
#include "tests/device/accuracy/cases.h"

namespace dr::accuracy {

using ir::Builder;
using ir::kBool;
using ir::kFloat;
using ir::kInt;
using ir::OpKind;
using ir::Scalar;
using ir::Type;
using ir::ValueId;

inline constexpr double kAll = FLT_MAX;

inline ir::Attrs ints(std::vector<int64_t> values) {
  ir::Attrs attrs;
  attrs.ints = std::move(values);
  return attrs;
}
inline Operand all_floats(Type type = kFloat) { return {.type = type, .low = -kAll, .high = kAll}; }
inline Operand floats(double low, double high, double least = 0, Type type = kFloat) {
  return {.type = type, .low = low, .high = high, .least = least};
}
inline Operand words(Type type) {
  if (type.is_bool()) return {.type = type, .low = 0, .high = 1};
  return type.scalar == Scalar::Uint ? Operand{.type = type, .low = 0, .high = 4294967295.0}
                                     : Operand{.type = type, .low = -2147483648.0, .high = 2147483647.0};
}

inline ValueId abs_of(Builder& b, ValueId x) { return ops::emit(b, OpKind::Abs, {x}); }
inline ValueId one(Builder& b) { return ops::constant(b, kFloat, 1.0); }

// The op of the case itself on its operands.
inline Case plain(OpKind kind, std::vector<Operand> operands, ir::Attrs attrs = {}) {
  Case c{.kind = kind, .name = std::string(ir::op_name(kind)), .operands = std::move(operands), .build = {}};
  c.build = [kind, attrs](Builder& b, const Values& xs) { return ops::emit(b, kind, xs, attrs); };
  c.bound = ops::info(kind).ulp_bound;
  c.why = "op table";
  return c;
}

}  // namespace dr::accuracy
