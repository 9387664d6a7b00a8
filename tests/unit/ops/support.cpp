// SPDX-License-Identifier: Apache-2.0
#include "tests/unit/ops/support.h"

#include <cmath>

#include "tests/catch.h"

namespace dr::ops_test {

Attrs ints(std::vector<int64_t> values) {
  Attrs attrs;
  attrs.ints = std::move(values);
  return attrs;
}

Value value(Type type, std::vector<double> planes) { return {.type = type, .planes = std::move(planes)}; }

Value evaluate(OpKind kind, const std::vector<Value>& operands, const Attrs& attrs) {
  std::vector<ir::ResultType> results;
  std::vector<Type> types;
  std::vector<const double*> planes;
  for (const Value& operand : operands) {
    results.push_back({.type = operand.type, .extent = {}});
    types.push_back(operand.type);
    planes.push_back(operand.planes.data());
  }
  const ops::OpInfo& info = ops::info(kind);
  const ops::InferResult inferred = info.infer({.operands = results, .attrs = attrs});
  if (const auto* wrong = std::get_if<std::string>(&inferred)) FAIL(*wrong);
  const Type type = std::get<std::vector<ir::ResultType>>(inferred).at(0).type;
  const size_t n = operands[0].planes.size() / static_cast<size_t>(types[0].components());
  Value result{.type = type, .planes = std::vector<double>(n * static_cast<size_t>(type.components()))};
  info.eval({.n = n,
             .operands = planes,
             .operand_types = types,
             .attrs = attrs,
             .result_type = type,
             .result = result.planes.data()});
  return result;
}

double evaluate(OpKind kind, double x) { return evaluate(kind, {value(ir::kFloat, {x})}).planes[0]; }
double evaluate(OpKind kind, double x, double y) {
  return evaluate(kind, {value(ir::kFloat, {x}), value(ir::kFloat, {y})}).planes[0];
}

std::vector<OpKind> elementwise_kinds() {
  std::vector<OpKind> kinds;
  for (const OpKind kind : ir::all_op_kinds()) {
    if (ops::info(kind).shape == ops::Shape::Elementwise) kinds.push_back(kind);
  }
  return kinds;
}

std::vector<Form> forms(OpKind kind) {
  std::vector<Type> types;
  for (const Scalar scalar : {Scalar::Bool, Scalar::Int, Scalar::Uint, Scalar::Float}) {
    for (int rows = 1; rows <= 4; ++rows) types.push_back(ir::vec(rows, scalar));
  }
  for (uint8_t cols = 2; cols <= 4; ++cols) {
    for (uint8_t rows = 2; rows <= 4; ++rows) types.push_back({Scalar::Float, rows, cols});
  }
  std::vector<Attrs> attributes{{}};
  for (int64_t k = 0; k <= 4; ++k) attributes.push_back(ints({k}));
  for (int64_t rows = 2; rows <= 4; ++rows) {
    for (int64_t cols = 1; cols <= 4; ++cols) attributes.push_back(ints({rows, cols}));
  }

  std::vector<Form> result;
  const auto add = [&](std::vector<Type> operands) {
    std::vector<ir::ResultType> operand_types;
    for (const Type& type : operands) operand_types.push_back({.type = type, .extent = {}});
    for (const Attrs& attrs : attributes) {
      const ops::InferResult inferred = ops::info(kind).infer({.operands = operand_types, .attrs = attrs});
      const auto* results = std::get_if<std::vector<ir::ResultType>>(&inferred);
      if (results == nullptr) continue;
      result.push_back({.operands = operands, .attrs = attrs, .result = results->at(0).type});
      // An op that does not look at attributes takes all of them alike.
      if (attrs == Attrs{}) break;
    }
  };
  for (const Type& type : types) {
    for (size_t count = 1; count <= 4; ++count) add(std::vector<Type>(count, type));
    if (kind != OpKind::Select) continue;
    add({ir::kBool, type, type});
    if (!type.is_matrix() && !type.is_scalar()) add({type.with_scalar(Scalar::Bool), type, type});
  }
  return result;
}

std::vector<double> finite_special_values() {
  std::vector<double> values;
  for (const double x : {0.0, 0x1p-149, 0x0.fffffep-126, 0x1p-126, 1.0, 0x1p24, 0x1.fffffep127}) {
    values.push_back(x);
    values.push_back(-x);
  }
  values.push_back(1 + 0x1p-23);
  values.push_back(1 - 0x1p-24);
  return values;
}

bool is_finite(double x) { return std::isfinite(x); }

}  // namespace dr::ops_test
