// SPDX-License-Identifier: Apache-2.0
// Matrices. The graph has no matrix arithmetic beyond taking columns out and putting them together, so that the op set
// stays small: products, transposes and inverses are spelled out in vectors and scalars.
#include "compiler/lower/elaborator.h"

namespace dr::lower {

Value Elaborator::map_columns(const Value& m, const std::function<Value(const Value&)>& f) {
  std::vector<Value> columns;
  const Type type = element_type(m);
  for (int c = 0; c < type.cols; ++c) {
    columns.push_back(f(component(m, c)));
    if (columns.back().is_error()) return Error{};
  }
  return compose(std::move(columns), type);
}

// Operands of one shape, or a matrix and a scalar, component by component.
Value Elaborator::matrix_scalar(OpKind kind, const Value& a, const Value& b) {
  const bool matrix_a = element_type(a).is_matrix(), matrix_b = element_type(b).is_matrix();
  const Type type = matrix_a ? element_type(a) : element_type(b);
  std::vector<Value> columns;
  for (int c = 0; c < type.cols; ++c) {
    const Value of_b = matrix_b ? component(b, c) : b, of_a = matrix_a ? component(a, c) : a;
    columns.push_back(arithmetic(kind, of_a, of_b));
    if (columns.back().is_error()) return Error{};
  }
  return compose(std::move(columns), type);
}

// The columns weighted by the vector's components, in order.
Value Elaborator::matrix_vector(const Value& m, const Value& v) {
  const auto term = [&](int c) {
    const Value weight = component(v, c), column = component(m, c);
    return mul(column, weight);
  };
  Value sum = term(0);
  for (int c = 1; c < element_type(m).cols && !sum.is_error(); ++c) sum = add(sum, term(c));
  return sum;
}

// `done` stays false where the operands are not a product's.
Value Elaborator::matrix_product(const Value& a, const Value& b, const Span& span, bool& done) {
  const Type type_a = element_type(a), type_b = element_type(b);
  if (type_a.is_scalar() || type_b.is_scalar()) return Error{};
  done = true;
  if (!check_extents(std::vector<Value>{a, b}, span)) return Error{};
  const int inner_a = type_a.is_matrix() ? type_a.cols : type_a.rows;  // a vector on the left is a row
  if (inner_a != type_b.rows) {
    return fail(Code::E0301, span,
                "cannot multiply " + type_a.str() + " and " + type_b.str() + ", expected " + std::to_string(inner_a) +
                    " rows on the right, found " + std::to_string(type_b.rows));
  }
  if (type_a.is_matrix() && type_b.is_vector()) return matrix_vector(a, b);
  std::vector<Value> parts;
  for (int c = 0; c < type_b.cols; ++c) {
    const Value column = component(b, c);
    parts.push_back(type_a.is_matrix() ? matrix_vector(a, column) : dot(a, column));
    if (parts.back().is_error()) return Error{};
  }
  return compose(std::move(parts),
                 type_a.is_matrix() ? Type{Scalar::Float, type_a.rows, type_b.cols} : ir::vec(type_b.cols));
}

Value Elaborator::transpose(const Value& m) {
  const Type type = element_type(m);
  const Entries all = entries(m);
  std::vector<Value> columns;
  for (size_t r = 0; r < type.rows; ++r) {
    std::vector<Value> row;
    for (size_t c = 0; c < type.cols; ++c) row.push_back(all[c][r]);
    columns.push_back(compose(std::move(row), ir::vec(type.cols)));
  }
  return compose(std::move(columns), Type{Scalar::Float, type.cols, type.rows});
}

// All entries, [column][row], each taken out once.
Elaborator::Entries Elaborator::entries(const Value& m) {
  Entries all;
  const Type type = element_type(m);
  for (int c = 0; c < type.cols; ++c) {
    const Value column = component(m, c);
    std::vector<Value>& rows = all.emplace_back();
    for (int r = 0; r < type.rows; ++r) rows.push_back(component(column, r));
  }
  return all;
}

// The determinant of the square matrix that these columns and rows leave.
Value Elaborator::minor_determinant(const Entries& m, const std::vector<size_t>& columns,
                                    const std::vector<size_t>& rows) {
  if (columns.size() == 1) return m[columns[0]][rows[0]];
  if (columns.size() == 2) {
    const Value taken = mul(m[columns[1]][rows[0]], m[columns[0]][rows[1]]);
    return sub(mul(m[columns[0]][rows[0]], m[columns[1]][rows[1]]), taken);
  }
  Value sum;
  const std::vector<size_t> rest(columns.begin() + 1, columns.end());
  for (size_t i = 0; i < rows.size(); ++i) {
    std::vector<size_t> other_rows = rows;
    other_rows.erase(other_rows.begin() + static_cast<std::ptrdiff_t>(i));
    const Value term = mul(m[columns[0]][rows[i]], minor_determinant(m, rest, other_rows));
    sum = i == 0 ? term : i % 2 == 1 ? sub(sum, term) : add(sum, term);
  }
  return sum;
}

namespace {

std::vector<size_t> all_but(size_t count, size_t left_out) {
  std::vector<size_t> indices;
  for (size_t i = 0; i < count; ++i) {
    if (i != left_out) indices.push_back(i);
  }
  return indices;
}

}  // namespace

Value Elaborator::builtin_transpose(BuiltinCall& call) {
  if (!call.args[0].is_numeric() || !element_type(call.args[0]).is_matrix()) return wrong_type(call, 0, "a matrix");
  return transpose(call.args[0]);
}

Value Elaborator::builtin_matrix_comp_mult(BuiltinCall& call) {
  for (size_t i = 0; i < 2; ++i) {
    if (!call.args[i].is_numeric() || !element_type(call.args[i]).is_matrix()) return wrong_type(call, i, "a matrix");
  }
  if (element_type(call.args[0]) != element_type(call.args[1])) {
    return fail(Code::E0322, call.span,
                "expected matrices of one size for 'matrixCompMult', found " + describe_element(call.args[0]) +
                    " and " + describe_element(call.args[1]));
  }
  if (!check_extents(call.args, call.span)) return Error{};
  return matrix_scalar(OpKind::Mul, call.args[0], call.args[1]);
}

Value Elaborator::builtin_determinant(BuiltinCall& call) {
  const Value& m = call.args[0];
  if (!m.is_numeric() || !element_type(m).is_matrix() || element_type(m).rows != element_type(m).cols)
    return wrong_type(call, 0, "a square matrix");
  const size_t n = element_type(m).rows;
  return minor_determinant(entries(m), all_but(n, n), all_but(n, n));
}

// The transposed cofactors over the determinant.
Value Elaborator::builtin_inverse(BuiltinCall& call) {
  const Value& m = call.args[0];
  if (!m.is_numeric() || !element_type(m).is_matrix() || element_type(m).rows != element_type(m).cols)
    return wrong_type(call, 0, "a square matrix");
  const Type type = element_type(m);
  const Entries all = entries(m);
  const size_t n = type.rows;
  Entries cofactors;  // [column][row] of m
  for (size_t c = 0; c < n; ++c) {
    std::vector<Value>& column = cofactors.emplace_back();
    for (size_t r = 0; r < n; ++r) {
      const Value minor = minor_determinant(all, all_but(n, c), all_but(n, r));
      if (minor.is_error()) return Error{};
      column.push_back((c + r) % 2 == 0 ? minor : apply(OpKind::Neg, {minor}));
    }
  }
  Value determinant = mul(all[0][0], cofactors[0][0]);
  for (size_t r = 1; r < n; ++r) determinant = add(determinant, mul(all[0][r], cofactors[0][r]));
  std::vector<Value> columns;
  for (size_t c = 0; c < n; ++c) {
    std::vector<Value> column;
    for (size_t r = 0; r < n; ++r) column.push_back(cofactors[r][c]);
    columns.push_back(arithmetic(OpKind::Div, compose(std::move(column), ir::vec(type.rows)), determinant));
    if (columns.back().is_error()) return Error{};
  }
  return compose(std::move(columns), type);
}

Value Elaborator::builtin_outer_product(BuiltinCall& call) {
  for (size_t i = 0; i < 2; ++i) {
    if (!call.args[i].is_numeric() || !element_type(call.args[i]).is_vector() ||
        !element_type(call.args[i]).is_float()) {
      return wrong_type(call, i, "a vector of floats");
    }
  }
  const int cols = element_type(call.args[1]).rows;
  std::vector<Value> columns;
  for (int c = 0; c < cols; ++c) {
    columns.push_back(mul(call.args[0], component(call.args[1], c)));
    if (columns.back().is_error()) return Error{};
  }
  return compose(std::move(columns), Type{Scalar::Float, element_type(call.args[0]).rows, static_cast<uint8_t>(cols)});
}

}  // namespace dr::lower
