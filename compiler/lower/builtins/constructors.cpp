// SPDX-License-Identifier: Apache-2.0
// Types as functions: conversions, GLSL's vector and matrix constructors, structs.
#include <algorithm>
#include <numeric>

#include "compiler/lower/elaborator.h"

namespace dr::lower {

Value Elaborator::construct(const TypeValue& type, std::vector<Argument> args, const Span& span) {
  if (type.kind == TypeValue::Kind::Struct) return construct_struct(type, std::move(args), span);
  if (type.kind != TypeValue::Kind::Element)
    return fail(Code::E0306, span, "expected a function before '(', found the type " + describe(type));
  std::vector<Value> values;
  const std::string name = type.element.str();
  for (const Argument& arg : args) {
    if (contains_error(arg.value)) return Error{};
    if (arg.name)
      return fail(Code::E0305, arg.name->span,
                  "expected arguments without names for '" + name + "', found '" + arg.name->text + "'");
    if (!arg.value.is_numeric()) {
      return fail(Code::E0322, arg.span, "expected numbers for '" + name + "', found " + describe_element(arg.value));
    }
    values.push_back(arg.value);
  }
  if (values.empty()) return fail(Code::E0315, span, "expected components for " + name + ", found none");
  return type.element.is_matrix() ? construct_matrix(type.element, values, span)
                                  : construct_vector(type.element, values, span);
}

Value Elaborator::construct_vector(const Type& type, std::span<const Value> args, const Span& span) {
  if (args.size() == 1) {
    const Type from = element_type(args[0]);
    if (type.is_scalar() && from.is_scalar()) {
      // int of an extent stays known at compile time.
      return convert_scalar(args[0], type.scalar);
    }
    if (from.is_scalar()) return splat(convert_scalar(args[0], type.scalar), type);
    if (from.is_vector() && type.is_vector() && from.rows >= type.rows) {
      std::vector<int> indices(type.rows);
      std::iota(indices.begin(), indices.end(), 0);
      const Value converted = convert_scalar(swizzle(args[0], indices), type.scalar);
      return converted;
    }
  }
  std::vector<Value> parts;
  size_t count = 0;
  for (const Value& arg : args) {
    const Type from = element_type(arg);
    count += static_cast<size_t>(from.components());
    if (from.is_matrix())
      return fail(Code::E0315, span, "expected scalars and vectors for " + type.str() + ", found " + from.str());
  }
  if (count != type.rows) {
    return fail(Code::E0315, span,
                "expected " + std::to_string(type.rows) + (type.rows == 1 ? " component for " : " components for ") +
                    type.str() + ", found " + std::to_string(count));
  }
  for (const Value& arg : args) {
    const Value converted = convert_scalar(arg, type.scalar);
    if (converted.is_error()) return Error{};
    for (int i = 0; i < element_type(converted).rows; ++i) parts.push_back(component(converted, i));
  }
  return compose(std::move(parts), type);
}

Value Elaborator::construct_matrix(const Type& type, std::span<const Value> args, const Span& span) {
  const Type first = element_type(args[0]);
  std::vector<Value> columns;
  if (args.size() == 1 && (first.is_scalar() || first.is_matrix())) {
    // A scalar on the diagonal, or a matrix cut out or filled up with that of ones.
    const Value scalar = first.is_scalar() ? convert_scalar(args[0], Scalar::Float) : make_float(1);
    for (int c = 0; c < type.cols; ++c) {
      std::vector<Value> column;
      for (int r = 0; r < type.rows; ++r) {
        const bool inside = first.is_matrix() && c < first.cols && r < first.rows;
        column.push_back(inside ? component(component(args[0], c), r) : c == r ? scalar : make_float(0));
      }
      columns.push_back(compose(std::move(column), type.column()));
      if (columns.back().is_error()) return Error{};
    }
    return compose(std::move(columns), type);
  }
  std::vector<Value> all;
  bool are_columns = args.size() == type.cols;
  for (const Value& arg : args) {
    const Type from = element_type(arg);
    are_columns = are_columns && from.rows == type.rows && from.cols == 1;
    if (from.is_matrix())
      return fail(Code::E0315, span, "expected scalars and vectors for " + type.str() + ", found " + from.str());
  }
  for (const Value& arg : args) {
    const Value converted = convert_scalar(arg, Scalar::Float);
    if (converted.is_error()) return Error{};
    columns.push_back(converted);
    for (int i = 0; i < element_type(arg).rows && !are_columns; ++i) all.push_back(component(converted, i));
  }
  if (are_columns) return compose(std::move(columns), type);
  if (all.size() != static_cast<size_t>(type.components())) {
    return fail(Code::E0315, span,
                "expected " + std::to_string(type.components()) + " components for " + type.str() + ", found " +
                    std::to_string(all.size()));
  }
  columns.clear();
  for (size_t c = 0; c < type.cols; ++c) {
    std::vector<Value> column(all.begin() + static_cast<std::ptrdiff_t>(c * type.rows),
                              all.begin() + static_cast<std::ptrdiff_t>((c + 1) * type.rows));
    columns.push_back(compose(std::move(column), type.column()));
    if (columns.back().is_error()) return Error{};
  }
  return compose(std::move(columns), type);
}

Value Elaborator::construct_struct(const TypeValue& type, std::vector<Argument> args, const Span& span) {
  const StructType& structure = *type.structure;
  if (!structure.decl)
    return fail(Code::E0306, span, "expected a function before '(', found the type " + structure.name);
  const dsl::StructDecl& decl = *structure.decl;
  Scope* scope = new_scope(&structure.module->scope);
  // A type that is known by its arguments already (`T` of a generic function) says what its generic names are.
  for (size_t i = 0; i < type.generics.size(); ++i) define(*scope, decl.generics[i], type.generics[i]);
  if (!bind_params(decl.fields, decl.generics, std::move(args), *scope, span, structure.name, decl.name.span, false))
    return Error{};
  StructValue value;
  value.type = &structure;
  for (const dsl::Name& generic : decl.generics) value.generics.push_back(scope->find(generic.text)->value);
  size_t parts = 0;
  for (const dsl::Param& field : decl.fields) {
    value.fields.push_back(scope->find(field.name.text)->value);
    if (!has_room(value.fields.back(), parts, span)) return Error{};
  }
  return value;
}

}  // namespace dr::lower
