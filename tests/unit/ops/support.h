// SPDX-License-Identifier: Apache-2.0
// Running entries of the op table by hand: evaluating one op, and every form of operands that an op takes.
#pragma once

#include <vector>

#include "compiler/ops/op.h"

namespace dr::ops_test {

using ir::Attrs;
using ir::OpKind;
using ir::Scalar;
using ir::Type;

Attrs ints(std::vector<int64_t> values);

// One operand or result: component-major planes.
struct Value {
  Type type;
  std::vector<double> planes;
};
Value value(Type type, std::vector<double> planes);

// The result's type by the op's own rule, its elements by the op's evaluation.
Value evaluate(OpKind kind, const std::vector<Value>& operands, const Attrs& attrs = {});
// For floats: f(x), f(x, y).
double evaluate(OpKind kind, double x);
double evaluate(OpKind kind, double x, double y);

// A combination of operand types and attributes that an element-wise op accepts.
struct Form {
  std::vector<Type> operands;
  Attrs attrs;
  Type result;
};
std::vector<Form> forms(OpKind kind);
std::vector<OpKind> elementwise_kinds();

// +-0, +-smallest and largest subnormal, +-smallest normal, +-1, 1 +- ulp, +-2^24, +-largest of float32.
std::vector<double> finite_special_values();
bool is_finite(double x);

}  // namespace dr::ops_test
