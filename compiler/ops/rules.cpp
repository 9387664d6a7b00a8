// SPDX-License-Identifier: Apache-2.0
// Type rules and forms that the families share.
#include "compiler/ops/rules.h"

namespace dr::ops::rules {

bool accepts(Accepts what, Type type) {
  if (type.is_matrix()) return (what & kMatrices) != 0;
  switch (type.scalar) {
    case Scalar::Float: return (what & kFloats) != 0;
    case Scalar::Int:
    case Scalar::Uint: return (what & kInts) != 0;
    case Scalar::Bool: return (what & kBools) != 0;
  }
  DR_ICE("no such element type");
}

std::string words(const ResultType& type) { return type.type.str() + type.extent.str(); }

InferResult one(Type type, const Extent& extent) { return std::vector<ResultType>{{.type = type, .extent = extent}}; }

namespace {

std::string expect(std::string_view what, size_t found, size_t wanted) {
  if (found == wanted) return "";
  return "expected " + std::to_string(wanted) + " " + std::string(what) + ", found " + std::to_string(found);
}

}  // namespace

std::string expect_operands(const InferInput& in, size_t count) {
  return expect("operands", in.operands.size(), count);
}
std::string expect_ints(const Attrs& attrs, size_t count) { return expect("ints", attrs.ints.size(), count); }
std::string expect_dims(const Attrs& attrs, size_t count) { return expect("dims", attrs.dims.size(), count); }

std::string expect_accepted(std::span<const ResultType> operands, Accepts what) {
  for (const ResultType& operand : operands) {
    if (!accepts(what, operand.type)) return "does not take " + operand.type.str();
  }
  return "";
}

std::string expect_equal_types(const ResultType& a, const ResultType& b) {
  return a.type == b.type ? "" : "operands differ: " + a.type.str() + " and " + b.type.str();
}

std::variant<Extent, std::string> common_extent(std::span<const ResultType> operands) {
  Extent common;
  for (const ResultType& operand : operands) {
    const auto next = ir::broadcast(common, operand.extent);
    if (!next) return "extents do not agree: " + common.str() + " and " + operand.extent.str();
    common = *next;
  }
  return common;
}

Extent extent_of(const Attrs& attrs) { return {attrs.dims[0], attrs.dims[1], attrs.dims[2]}; }

bool stretches_to(const Extent& extent, const Extent& domain) {
  const auto common = ir::broadcast(extent, domain);
  return common && *common == domain;
}

namespace {

InferResult element_wise(const InferInput& in, size_t count, Accepts what, bool to_bool) {
  if (std::string wrong = expect_operands(in, count); !wrong.empty()) return wrong;
  for (const ResultType& operand : in.operands.subspan(1)) {
    if (std::string wrong = expect_equal_types(in.operands[0], operand); !wrong.empty()) return wrong;
  }
  if (std::string wrong = expect_accepted(in.operands, what); !wrong.empty()) return wrong;
  auto extent = common_extent(in.operands);
  if (auto* wrong = std::get_if<std::string>(&extent)) return std::move(*wrong);
  const Type type = in.operands[0].type;
  return one(to_bool ? type.with_scalar(Scalar::Bool) : type, std::get<Extent>(extent));
}

}  // namespace

InferResult same_types(const InferInput& in, size_t count, Accepts what) {
  return element_wise(in, count, what, false);
}
InferResult comparison(const InferInput& in, Accepts what) { return element_wise(in, 2, what, true); }

std::string call(std::string_view name, const GlslInput& in) {
  std::string text = std::string(name) + "(";
  for (size_t k = 0; k < in.operands.size(); ++k) text += (k > 0 ? ", " : "") + in.operands[k];
  return text + ")";
}

std::string infix(const GlslInput& in, std::string_view op) {
  return in.operands[0] + " " + std::string(op) + " " + in.operands[1];
}

std::string prefix(const GlslInput& in, std::string_view op) {
  const std::string& x = in.operands[0];
  return std::string(op) + (x.starts_with('-') ? "(" + x + ")" : x);
}

ValueId safe_reciprocal(Builder& b, ValueId x) {
  const ValueId is_zero = apply(b, OpKind::Equal, x, zero_like(b, x));
  return drop_where(b, is_zero, div(b, like(b, x, 1.0), x));
}

}  // namespace dr::ops::rules
