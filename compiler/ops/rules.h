// SPDX-License-Identifier: Apache-2.0
// What the entries of the op table are written with: type rules, evaluation loops, forms of GLSL, short ways to emit.
// Internal to compiler/ops/.
#pragma once

#include <cmath>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "compiler/ops/emit.h"
#include "compiler/ops/op.h"

namespace dr::ops::rules {

using ir::Attrs;
using ir::Builder;
using ir::Dim;
using ir::Extent;
using ir::OpKind;
using ir::ResultType;
using ir::Scalar;
using ir::Type;
using ir::ValueId;

// --- type rules ---

// Which operand types a rule takes. Matrices are Float, so kMatrices only matters beside kFloats.
using Accepts = unsigned;
inline constexpr Accepts kFloats = 1, kInts = 2, kBools = 4, kMatrices = 8;
inline constexpr Accepts kNumbers = kFloats | kInts;
inline constexpr Accepts kAnything = kFloats | kInts | kBools | kMatrices;

bool accepts(Accepts what, Type type);
std::string words(const ResultType& type);  // "vec3[V]"
InferResult one(Type type, const Extent& extent);

// Each gives a sentence when it does not hold, "" when it does.
std::string expect_operands(const InferInput& in, size_t count);
std::string expect_ints(const Attrs& attrs, size_t count);
std::string expect_dims(const Attrs& attrs, size_t count);
std::string expect_accepted(std::span<const ResultType> operands, Accepts what);
std::string expect_equal_types(const ResultType& a, const ResultType& b);

// The common extent of the operands, or the sentence that says which two do not agree.
std::variant<Extent, std::string> common_extent(std::span<const ResultType> operands);
Extent extent_of(const Attrs& attrs);  // attrs.dims[0..2]
bool stretches_to(const Extent& extent, const Extent& domain);

// `count` operands of one type that `what` accepts; the result has that type (or its Bool counterpart).
InferResult same_types(const InferInput& in, size_t count, Accepts what);
InferResult comparison(const InferInput& in, Accepts what);
// The same as function pointers for the table.
template <size_t count, Accepts what>
InferResult component_wise(const InferInput& in) {
  return same_types(in, count, what);
}

// --- evaluation ---

inline size_t plane_count(const EvalBatch& e) { return e.n * static_cast<size_t>(e.result_type.components()); }

// An integer brought to 32 bits; only the low ones count, so callers may let int64 or uint64 arithmetic wrap.
inline double wrap(Type type, int64_t x) {
  const auto low = static_cast<uint32_t>(x);
  return type.scalar == Scalar::Int ? static_cast<double>(static_cast<int32_t>(low)) : static_cast<double>(low);
}
inline int64_t integer(double x) { return static_cast<int64_t>(x); }

// f over numbers, component by component.
template <class F>
void map1(const EvalBatch& e, F f) {
  const size_t count = plane_count(e);
  const double* x = e.operands[0];
  for (size_t i = 0; i < count; ++i) e.result[i] = f(x[i]);
}
template <class F>
void map2(const EvalBatch& e, F f) {
  const size_t count = plane_count(e);
  const double *x = e.operands[0], *y = e.operands[1];
  for (size_t i = 0; i < count; ++i) e.result[i] = f(x[i], y[i]);
}
template <class F>
void map3(const EvalBatch& e, F f) {
  const size_t count = plane_count(e);
  const double *x = e.operands[0], *y = e.operands[1], *z = e.operands[2];
  for (size_t i = 0; i < count; ++i) e.result[i] = f(x[i], y[i], z[i]);
}
// Floats by `f`, Int and Uint by `g` on int64, wrapped.
template <class F, class G>
void numbers1(const EvalBatch& e, F f, G g) {
  const Type type = e.result_type;
  if (type.is_float()) return map1(e, f);
  map1(e, [&](double x) { return wrap(type, g(integer(x))); });
}
template <class F, class G>
void numbers2(const EvalBatch& e, F f, G g) {
  const Type type = e.result_type;
  if (type.is_float()) return map2(e, f);
  map2(e, [&](double x, double y) { return wrap(type, g(integer(x), integer(y))); });
}

// --- GLSL ---

// "a + b" and "-a". Operands are names or literals; only a literal's own sign needs care.
std::string infix(const GlslInput& in, std::string_view op);
std::string prefix(const GlslInput& in, std::string_view op);
// name(a, b, ..)
std::string call(std::string_view name, const GlslInput& in);
// The same as function pointers for the table: function<"floor">.
struct Name {
  char text[32] = {};
  template <size_t count>
  consteval Name(const char (&name)[count]) {  // NOLINT: a literal is a name
    for (size_t i = 0; i < count; ++i) text[i] = name[i];
  }
};
template <Name name>
std::string function(const GlslInput& in) {
  return call(name.text, in);
}
template <Name op>
std::string infix_of(const GlslInput& in) {
  return infix(in, op.text);
}

// --- adjoints ---

// A constant of x's type.
inline ValueId like(Builder& b, ValueId x, double value) { return constant(b, b.value(x).type, value); }
inline ValueId apply(Builder& b, OpKind kind, ValueId x) { return emit(b, kind, {x}); }
inline ValueId apply(Builder& b, OpKind kind, ValueId x, ValueId y) { return emit(b, kind, {x, y}); }
// x where c, 0 elsewhere; the other way round.
inline ValueId keep_where(Builder& b, ValueId c, ValueId x) { return select(b, c, x, zero_like(b, x)); }
inline ValueId drop_where(Builder& b, ValueId c, ValueId x) { return select(b, c, zero_like(b, x), x); }
// 1 / x, and 0 where x is 0.
ValueId safe_reciprocal(Builder& b, ValueId x);

inline constexpr ValueId kNoAdjoint{};

// The adjoint of an op of one operand from its local derivative, d(builder, operand, result).
template <auto d>
AdjointOutput chain(const AdjointInput& in) {
  return {smul(in.builder, in.adjoint, d(in.builder, in.operands[0], in.result))};
}

}  // namespace dr::ops::rules
