// SPDX-License-Identifier: Apache-2.0
// Float functions, component by component. Derivatives are written in forms that stay accurate where the obvious ones
// cancel or overflow, and are 0 where the function has none.
#include <algorithm>
#include <numbers>

#include "compiler/ops/families.h"
#include "compiler/ops/prelude.h"
#include "compiler/ops/rules.h"

namespace dr::ops {

using namespace rules;

namespace {

constexpr double kTau = 2 * std::numbers::pi;

double sigmoid(double x) {
  const double z = std::exp(-std::abs(x));
  return (x < 0 ? z : 1.0) / (1.0 + z);
}

// As in GLSL: zeros have no sign, a negative number has whole powers only.
double power(double x, double y) {
  if (x < 0 && std::floor(y) != y) return std::nan("");
  return std::pow(x == 0 ? 0.0 : x, y);
}

double fract(double x) {
  const double r = x - std::floor(x);
  return r >= 1 ? std::nextafter(1.0, 0.0) : r;
}

constexpr double kLargestHalf = 65504;

// The nearest float16, of two as near the even one. Its last place is 2^-24 at least.
double nearest_half(double x) {
  if (std::isnan(x)) return x;
  const double size = std::min(std::abs(x), kLargestHalf);
  const double unit = std::max(std::exp2(-24), std::exp2(std::ilogb(std::max(size, 0x1p-30)) - 10));
  return std::copysign(std::nearbyint(size / unit) * unit, x);
}

// By the result, which is what is stored: x would have to be kept for it.
AdjointOutput half_adjoint(const AdjointInput& in) {
  Builder& b = in.builder;
  const ValueId largest = like(b, in.result, kLargestHalf);
  const ValueId inside = apply(b, OpKind::Less, apply(b, OpKind::Abs, in.result), largest);
  return {keep_where(b, inside, in.adjoint)};
}

double log_add_exp(double x, double y) {
  if (std::isnan(x) || std::isnan(y)) return std::nan("");
  return std::max(x, y) + std::log1p(std::exp(x == y ? 0.0 : -std::abs(x - y)));
}

// The share of each operand, of equal ones a half: their difference is not taken where both are infinite.
AdjointOutput log_add_exp_adjoint(const AdjointInput& in) {
  Builder& b = in.builder;
  const ValueId x = in.operands[0], y = in.operands[1];
  const ValueId difference = sub(b, x, y);
  const ValueId apart = drop_where(b, apply(b, OpKind::Equal, x, y), difference);
  return {smul(b, in.adjoint, apply(b, OpKind::Sigmoid, apart)),
          smul(b, in.adjoint, apply(b, OpKind::Sigmoid, neg(b, apart)))};
}

// asin and acos are those of the clamped operand.
double into_unit(double x) { return x > 1 ? 1.0 : (x < -1 ? -1.0 : x); }

ValueId is_positive(Builder& b, ValueId x) { return apply(b, OpKind::Less, zero_like(b, x), x); }

// (1 - x)(1 + x)
ValueId one_less_square(Builder& b, ValueId one, ValueId x) {
  const ValueId above = add(b, one, x);
  return mul(b, sub(b, one, x), above);
}

// x where `positive` is above 0, else 0.
ValueId where_positive(Builder& b, ValueId positive, ValueId x) { return keep_where(b, is_positive(b, positive), x); }

// 1 / sqrt((1 - x)(1 + x)) inside (-1, 1), 0 outside.
ValueId asin_derivative(Builder& b, ValueId x) {
  const ValueId one = like(b, x, 1.0);
  const ValueId inside = apply(b, OpKind::Less, apply(b, OpKind::Abs, x), one);
  const ValueId square = one_less_square(b, one, x);
  return keep_where(b, inside, div(b, one, apply(b, OpKind::Sqrt, square)));
}

// 1 / sqrt(1 + x^2), where x^2 leaves the range: 1 / |x|.
ValueId asinh_derivative(Builder& b, ValueId x) {
  const ValueId one = like(b, x, 1.0);
  const ValueId size = apply(b, OpKind::Abs, x);
  const ValueId large = apply(b, OpKind::Less, like(b, x, 1e9), size);
  const ValueId near = select(b, large, one, x);
  const ValueId root = apply(b, OpKind::Sqrt, add(b, one, mul(b, near, near)));
  return div(b, one, select(b, large, size, root));
}

// 1 / (sqrt(x - 1) sqrt(x + 1)) above 1, 0 elsewhere.
ValueId acosh_derivative(Builder& b, ValueId x) {
  const ValueId one = like(b, x, 1.0);
  const ValueId above = apply(b, OpKind::Less, one, x);
  const ValueId low = apply(b, OpKind::Sqrt, sub(b, x, one)), high = apply(b, OpKind::Sqrt, add(b, x, one));
  return keep_where(b, above, div(b, one, mul(b, low, high)));
}

// 1 / ((1 - x)(1 + x)) inside (-1, 1), 0 elsewhere.
ValueId atanh_derivative(Builder& b, ValueId x) {
  const ValueId one = like(b, x, 1.0);
  const ValueId inside = apply(b, OpKind::Less, apply(b, OpKind::Abs, x), one);
  return keep_where(b, inside, div(b, one, one_less_square(b, one, x)));
}

AdjointOutput pow_adjoint(const AdjointInput& in) {
  Builder& b = in.builder;
  const ValueId x = in.operands[0], y = in.operands[1];
  const ValueId zero = zero_like(b, x), one = like(b, x, 1.0);
  // y x^y / x where that power neither vanishes nor is huge: y - 1 would be rounded, and its power may overflow where a
  // small y makes the product finite. Elsewhere y x^(y - 1); at x = 0 that is Inf for 0 < y < 1, where the derivative
  // is taken to be 0.
  const ValueId size = apply(b, OpKind::Abs, in.result);
  const ValueId not_huge = apply(b, OpKind::LessEqual, size, like(b, x, 0x1p120));
  const ValueId not_tiny = apply(b, OpKind::LessEqual, like(b, x, 0x1p-126), size);
  const ValueId moderate = apply(b, OpKind::LogicalAnd, not_tiny, not_huge);
  const ValueId by_power = smul(b, y, apply(b, OpKind::Pow, x, sub(b, y, one)));
  const ValueId in_x = select(b, moderate, div(b, smul(b, y, in.result), x), by_power);
  const ValueId below_one = apply(b, OpKind::Less, y, one);
  const ValueId vertical = apply(b, OpKind::LogicalAnd, apply(b, OpKind::Equal, x, zero), below_one);
  // x^y log(x), and 0 where the logarithm is not defined.
  const ValueId in_y = where_positive(b, x, mul(b, in.result, apply(b, OpKind::Log, x)));
  return {smul(b, in.adjoint, drop_where(b, vertical, in_x)), smul(b, in.adjoint, in_y)};
}

// (x, -y) / (x^2 + y^2), scaled by the larger of both so that nothing leaves the range, 0 at the origin.
AdjointOutput atan2_adjoint(const AdjointInput& in) {
  Builder& b = in.builder;
  const ValueId y = in.operands[0], x = in.operands[1];
  const ValueId zero = zero_like(b, x), one = like(b, x, 1.0);
  const ValueId size_y = apply(b, OpKind::Abs, y), size_x = apply(b, OpKind::Abs, x);
  const ValueId largest = apply(b, OpKind::Max, size_x, size_y);
  // The quotients do not depend on what they are scaled by, so no derivative goes through it.
  const ValueId scale = apply(b, OpKind::Detach, largest);
  const ValueId origin = apply(b, OpKind::Equal, scale, zero);
  const ValueId divisor = select(b, origin, one, scale);
  const ValueId scaled_x = div(b, x, divisor), scaled_y = div(b, y, divisor);
  const ValueId square_y = mul(b, scaled_y, scaled_y);
  const ValueId square = add(b, mul(b, scaled_x, scaled_x), square_y);
  const ValueId safe_square = select(b, origin, one, square);
  const ValueId in_y = drop_where(b, origin, div(b, div(b, scaled_x, safe_square), divisor));
  const ValueId in_x = drop_where(b, origin, div(b, div(b, scaled_y, safe_square), divisor));
  return {smul(b, in.adjoint, in_y), neg(b, smul(b, in.adjoint, in_x))};
}

}  // namespace

std::vector<OpInfo> math_ops() {
  constexpr auto infer1 = component_wise<1, kFloats>;
  constexpr auto infer2 = component_wise<2, kFloats>;
  return {
      {.kind = OpKind::Floor,
       .shape = Shape::Elementwise,
       .doc = "The largest whole number not above x. Derivative 0.",
       .cost = 1,
       .no_gradient = "$ is constant between its jumps, its derivative is zero",
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return std::floor(x); }); },
       .glsl = function<"floor">,
       .differentiable = false,
       .domains = {{-10, 10}},
       .singular = {{{0}}, {{1}}, {{-2}}},
       .ulp_bound = 0},
      {.kind = OpKind::Ceil,
       .shape = Shape::Elementwise,
       .doc = "The smallest whole number not below x. Derivative 0.",
       .no_gradient = "$ is constant between its jumps, its derivative is zero",
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return std::ceil(x); }); },
       .glsl = function<"ceil">,
       .differentiable = false,
       .domains = {{-10, 10}},
       .singular = {{{0}}, {{1}}, {{-2}}},
       .ulp_bound = 0},
      {.kind = OpKind::Round,
       .shape = Shape::Elementwise,
       .doc = "The nearest whole number, the even one of two. Derivative 0.",
       .no_gradient = "$ is constant between its jumps, its derivative is zero",
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return std::nearbyint(x); }); },
       .glsl = function<"roundEven">,
       .differentiable = false,
       .domains = {{-10, 10}},
       .singular = {{{0.5}}, {{1.5}}, {{-0.5}}},
       .ulp_bound = 0},
      {.kind = OpKind::Trunc,
       .shape = Shape::Elementwise,
       .doc = "The whole number next to x on the side of 0. Derivative 0.",
       .no_gradient = "$ is constant between its jumps, its derivative is zero",
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return std::trunc(x); }); },
       .glsl = function<"trunc">,
       .differentiable = false,
       .domains = {{-10, 10}},
       .singular = {{{0}}, {{1}}, {{-2}}},
       .ulp_bound = 0},
      {.kind = OpKind::Fract,
       .shape = Shape::Elementwise,
       .doc = "x - floor(x), always less than 1. Derivative 1 everywhere.",
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, fract); },
       .glsl = function<"dr_fract">,
       .prelude = {glsl::kFract},
       .vector_prelude = glsl::kFractVectors,
       .adjoint = [](const AdjointInput& in) -> AdjointOutput { return {in.adjoint}; },
       .domains = {{-3, 3}},
       .singular = {{{0}}, {{1}}, {{-2}}},
       .ulp_bound = 1},
      {.kind = OpKind::Half,
       .shape = Shape::Elementwise,
       .doc =
           "The nearest float16, of two as near the even one; 65504 with x's sign for what is larger. Buffers between "
           "passes keep it in 16 bits. Derivative 1, as if nothing were rounded, and 0 where that gives 65504.",
       .cost = 12,
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, nearest_half); },
       .glsl = function<"dr_half">,
       .prelude = {glsl::kHalf},
       .vector_prelude = glsl::kHalfVectors,
       .adjoint = half_adjoint,
       .domains = {{-3, 3}},
       .singular = {{{0}}, {{65504}}, {{-65520}}, {{1e30}}},
       .ulp_bound = 0},
      {.kind = OpKind::Sqrt,
       .shape = Shape::Elementwise,
       .doc = "Square root, NaN below 0. Derivative 0 for x <= 0.",
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return std::sqrt(x); }); },
       .glsl = function<"sqrt">,
       .adjoint =
           chain<[](Builder& b, ValueId x, ValueId y) { return where_positive(b, x, div(b, like(b, x, 0.5), y)); }>,
       .domains = {{0.01, 10}},
       .singular = {{{0}}},
       .ulp_bound = 4.5},
      {.kind = OpKind::InverseSqrt,
       .shape = Shape::Elementwise,
       .doc = "1 / sqrt(x): Inf at 0, NaN below. Derivative 0 for x <= 0.",
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return 1 / std::sqrt(x); }); },
       .glsl = [](const GlslInput& in) { return "1.0 / sqrt(" + in.operands[0] + ")"; },
       .native = [](const GlslInput& in) -> std::optional<std::string> { return call("inversesqrt", in); },
       .adjoint = chain<[](Builder& b, ValueId x, ValueId y) {
         const ValueId quotient = div(b, y, x);
         return where_positive(b, x, mul(b, like(b, x, -0.5), quotient));
       }>,
       .domains = {{0.01, 10}},
       .singular = {{{0}}},
       .ulp_bound = 7},
      {.kind = OpKind::Cbrt,
       .shape = Shape::Elementwise,
       .doc = "Cube root, of negative numbers too. Derivative 0 at 0.",
       .cost = 12,
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return std::cbrt(x); }); },
       .glsl = function<"dr_cbrt">,
       .prelude = {glsl::kCbrt},
       .vector_prelude = glsl::kCbrtVectors,
       .adjoint = chain<[](Builder& b, ValueId, ValueId y) {
         const ValueId is_zero = apply(b, OpKind::Equal, y, zero_like(b, y));
         const ValueId square = mul(b, y, y);
         return drop_where(b, is_zero, div(b, like(b, y, 1.0 / 3), square));
       }>,
       .domains = {{-10, 10}},
       .singular = {{{0}}, {{8}}, {{-27}}, {{1e-30}}, {{-1e30}}},
       .ulp_bound = 2},
      {.kind = OpKind::Exp,
       .shape = Shape::Elementwise,
       .doc = "e^x.",
       .cost = 20,
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return std::exp(x); }); },
       .glsl = function<"dr_exp">,
       .prelude = {glsl::kExpPart, glsl::kExp},
       .vector_prelude = glsl::kExpVectors,
       .adjoint = chain<[](Builder&, ValueId, ValueId y) { return y; }>,
       .domains = {{-20, 20}},
       .singular = {{{0}}, {{-1000}}},
       .ulp_bound = 2},
      {.kind = OpKind::Exp2,
       .shape = Shape::Elementwise,
       .doc = "2^x.",
       .cost = 20,
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return std::exp2(x); }); },
       .glsl = function<"dr_exp2">,
       .prelude = {glsl::kExpPart, glsl::kExp2},
       .vector_prelude = glsl::kExp2Vectors,
       .adjoint = chain<[](Builder& b, ValueId x, ValueId y) { return mul(b, y, like(b, x, std::numbers::ln2)); }>,
       .domains = {{-20, 20}},
       .singular = {{{0}}, {{-2000}}},
       .ulp_bound = 2},
      {.kind = OpKind::Expm1,
       .shape = Shape::Elementwise,
       .doc = "e^x - 1, accurate near 0.",
       .cost = 20,
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return std::expm1(x); }); },
       .glsl = function<"dr_expm1">,
       .prelude = {glsl::kExpPart, glsl::kExp, glsl::kExpm1},
       .vector_prelude = glsl::kExpm1Vectors,
       .adjoint = chain<[](Builder& b, ValueId x, ValueId) { return apply(b, OpKind::Exp, x); }>,
       .domains = {{-3, 3}},
       .singular = {{{0}}, {{-1000}}},
       .ulp_bound = 4},
      {.kind = OpKind::Log,
       .shape = Shape::Elementwise,
       .doc = "Natural logarithm: -Inf at 0, NaN below. Derivative 0 for x <= 0.",
       .cost = 20,
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return std::log(x == 0 ? 0.0 : x); }); },
       .glsl = function<"dr_log">,
       .prelude = {glsl::kLogPart, glsl::kLog},
       .vector_prelude = glsl::kLogVectors,
       .adjoint =
           chain<[](Builder& b, ValueId x, ValueId) { return where_positive(b, x, div(b, like(b, x, 1.0), x)); }>,
       .domains = {{0.01, 20}},
       .singular = {{{0}}, {{1}}},
       .ulp_bound = 3},
      {.kind = OpKind::Log2,
       .shape = Shape::Elementwise,
       .doc = "Logarithm to base 2: -Inf at 0, NaN below. Derivative 0 for x <= 0.",
       .cost = 20,
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return std::log2(x == 0 ? 0.0 : x); }); },
       .glsl = function<"dr_log2">,
       .prelude = {glsl::kLogPart, glsl::kLog2},
       .vector_prelude = glsl::kLog2Vectors,
       .adjoint = chain<[](Builder& b, ValueId x, ValueId) {
         return where_positive(b, x, div(b, like(b, x, std::numbers::log2e), x));
       }>,
       .domains = {{0.01, 20}},
       .singular = {{{0}}, {{1}}},
       .ulp_bound = 3},
      {.kind = OpKind::Log1p,
       .shape = Shape::Elementwise,
       .doc = "log(1 + x), accurate near 0: -Inf at -1, NaN below. Derivative 0 for x <= -1.",
       .cost = 20,
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return std::log1p(x); }); },
       .glsl = function<"dr_log1p">,
       .prelude = {glsl::kLogPart, glsl::kLog1p},
       .vector_prelude = glsl::kLog1pVectors,
       .adjoint = chain<[](Builder& b, ValueId x, ValueId) {
         const ValueId one = like(b, x, 1.0);
         const ValueId shifted = add(b, one, x);
         return where_positive(b, shifted, div(b, one, shifted));
       }>,
       .domains = {{-0.9, 10}},
       .singular = {{{-1}}, {{0}}},
       .ulp_bound = 4},
      {.kind = OpKind::Pow,
       .shape = Shape::Elementwise,
       .doc =
           "x^y. x^0 = 1^y = 1; 0^y is 0 or, below 0, Inf; NaN for x < 0 and a y that is not whole. d/dx is 0 at x = 0 "
           "for y < 1, d/dy is 0 for x <= 0.",
       .cost = 60,
       .is_function = true,
       .infer = infer2,
       .eval = [](const EvalBatch& e) { map2(e, power); },
       .glsl = function<"dr_pow">,
       .prelude = {glsl::kExpPart, glsl::kLogPart, glsl::kPow},
       .vector_prelude = glsl::kPowVectors,
       .adjoint = pow_adjoint,
       .domains = {{0.1, 5}, {-3, 3}},
       .singular = {{{0, 0}},
                    {{0, 0.5}},
                    {{0, 1}},
                    {{0, 2}},
                    {{0, 5}},
                    {{1, 0}},
                    {{-2, 2}},
                    {{-2, 3}},
                    {{1e-30, 0.5}},
                    {{1e30, 0.5}}},
       .ulp_bound = 10},
      {.kind = OpKind::Sin,
       .shape = Shape::Elementwise,
       .doc = "Sine. On devices for |x| < 8192; beyond that a number between -1 and 1.",
       .cost = 20,
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return std::sin(x); }); },
       .glsl = function<"dr_sin">,
       .prelude = {glsl::kSinPart, glsl::kSin},
       .vector_prelude = glsl::kSinVectors,
       .adjoint = chain<[](Builder& b, ValueId x, ValueId) { return apply(b, OpKind::Cos, x); }>,
       .domains = {{-kTau, kTau}},
       .singular = {{{0}}},
       .ulp_bound = 4},
      {.kind = OpKind::Cos,
       .shape = Shape::Elementwise,
       .doc = "Cosine. On devices for |x| < 8192; beyond that a number between -1 and 1.",
       .cost = 20,
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return std::cos(x); }); },
       .glsl = function<"dr_cos">,
       .prelude = {glsl::kSinPart, glsl::kCos},
       .vector_prelude = glsl::kCosVectors,
       .adjoint = chain<[](Builder& b, ValueId x, ValueId) { return neg(b, apply(b, OpKind::Sin, x)); }>,
       .domains = {{-kTau, kTau}},
       .singular = {{{0}}},
       .ulp_bound = 4},
      {.kind = OpKind::Tan,
       .shape = Shape::Elementwise,
       .doc = "Tangent. On devices for |x| < 8192.",
       .cost = 20,
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return std::tan(x); }); },
       .glsl = function<"dr_tan">,
       .prelude = {glsl::kSinPart, glsl::kTan},
       .vector_prelude = glsl::kTanVectors,
       .adjoint = chain<[](Builder& b, ValueId x, ValueId y) {
         const ValueId square = mul(b, y, y);
         return add(b, like(b, x, 1.0), square);
       }>,
       .domains = {{-1.5, 1.5}},
       .singular = {{{0}}},
       .ulp_bound = 8},
      {.kind = OpKind::Asin,
       .shape = Shape::Elementwise,
       .doc = "Arc sine of x clamped to [-1, 1]. Derivative 0 for |x| >= 1.",
       .cost = 20,
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return std::asin(into_unit(x)); }); },
       .glsl = function<"dr_asin">,
       .prelude = {glsl::kAsinPart, glsl::kAsin},
       .vector_prelude = glsl::kAsinVectors,
       .adjoint = chain<[](Builder& b, ValueId x, ValueId) { return asin_derivative(b, x); }>,
       .domains = {{-0.99, 0.99}},
       .singular = {{{-1}}, {{1}}, {{0}}, {{1.5}}},
       .ulp_bound = 8},
      {.kind = OpKind::Acos,
       .shape = Shape::Elementwise,
       .doc = "Arc cosine of x clamped to [-1, 1]. Derivative 0 for |x| >= 1.",
       .cost = 20,
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return std::acos(into_unit(x)); }); },
       .glsl = function<"dr_acos">,
       .prelude = {glsl::kAsinPart, glsl::kAcos},
       .vector_prelude = glsl::kAcosVectors,
       .adjoint = chain<[](Builder& b, ValueId x, ValueId) { return neg(b, asin_derivative(b, x)); }>,
       .domains = {{-0.99, 0.99}},
       .singular = {{{-1}}, {{1}}, {{0}}, {{1.5}}},
       .ulp_bound = 8},
      {.kind = OpKind::Atan,
       .shape = Shape::Elementwise,
       .doc = "Arc tangent.",
       .cost = 20,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return std::atan(x); }); },
       .glsl = function<"dr_atan">,
       .prelude = {glsl::kAtanPart, glsl::kAtan},
       .vector_prelude = glsl::kAtanVectors,
       .adjoint = chain<[](Builder& b, ValueId x, ValueId) {
         const ValueId one = like(b, x, 1.0);
         return div(b, one, add(b, one, mul(b, x, x)));
       }>,
       .domains = {{-10, 10}},
       .singular = {{{0}}, {{1}}},
       .ulp_bound = 8},
      {.kind = OpKind::Atan2,
       .shape = Shape::Elementwise,
       .doc = "The angle of (x, y), given as (y, x), in (-pi, pi]; a zero counts as positive. Value and derivatives 0 "
              "at the origin.",
       .cost = 20,
       .infer = infer2,
       .eval =
           [](const EvalBatch& e) {
             map2(e, [](double y, double x) { return std::atan2(y == 0 ? 0.0 : y, x == 0 ? 0.0 : x); });
           },
       .glsl = function<"dr_atan2">,
       .prelude = {glsl::kAtanPart, glsl::kAtan2},
       .vector_prelude = glsl::kAtan2Vectors,
       .adjoint = atan2_adjoint,
       .domains = {{-3, 3}, {-3, 3}},
       .singular = {{{0, 0}}, {{0, 1}}, {{1, 0}}, {{-1, 0}}, {{1, 1}}, {{-2, -2}}, {{1e-30, 2e-30}}, {{1e30, 1e30}}},
       .ulp_bound = 8},
      {.kind = OpKind::Sinh,
       .shape = Shape::Elementwise,
       .doc = "Hyperbolic sine.",
       .cost = 20,
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return std::sinh(x); }); },
       .glsl = function<"dr_sinh">,
       .prelude = {glsl::kExpPart, glsl::kExp, glsl::kExpm1, glsl::kSinh},
       .vector_prelude = glsl::kSinhVectors,
       .adjoint = chain<[](Builder& b, ValueId x, ValueId) { return apply(b, OpKind::Cosh, x); }>,
       .domains = {{-5, 5}},
       .singular = {{{0}}},
       .ulp_bound = 6},
      {.kind = OpKind::Cosh,
       .shape = Shape::Elementwise,
       .doc = "Hyperbolic cosine.",
       .cost = 20,
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return std::cosh(x); }); },
       .glsl = function<"dr_cosh">,
       .prelude = {glsl::kExpPart, glsl::kExp, glsl::kCosh},
       .vector_prelude = glsl::kCoshVectors,
       .adjoint = chain<[](Builder& b, ValueId x, ValueId) { return apply(b, OpKind::Sinh, x); }>,
       .domains = {{-5, 5}},
       .singular = {{{0}}},
       .ulp_bound = 4},
      {.kind = OpKind::Tanh,
       .shape = Shape::Elementwise,
       .doc = "Hyperbolic tangent.",
       .cost = 20,
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return std::tanh(x); }); },
       .glsl = function<"dr_tanh">,
       .prelude = {glsl::kExpPart, glsl::kExp, glsl::kExpm1, glsl::kTanh},
       .vector_prelude = glsl::kTanhVectors,
       // 1 - tanh(x)^2 without the cancellation: 4 sigmoid(2x) sigmoid(-2x).
       .adjoint = chain<[](Builder& b, ValueId x, ValueId) {
         const ValueId up = apply(b, OpKind::Sigmoid, mul(b, x, like(b, x, 2.0)));
         const ValueId down = apply(b, OpKind::Sigmoid, mul(b, x, like(b, x, -2.0)));
         const ValueId product = mul(b, up, down);
         return mul(b, like(b, x, 4.0), product);
       }>,
       .domains = {{-5, 5}},
       .singular = {{{0}}, {{-1000}}, {{1000}}},
       .ulp_bound = 6},
      {.kind = OpKind::Asinh,
       .shape = Shape::Elementwise,
       .doc = "Inverse hyperbolic sine, with full relative accuracy near 0.",
       .cost = 20,
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return std::asinh(x); }); },
       .glsl = function<"dr_asinh">,
       .prelude = {glsl::kLogPart, glsl::kLog, glsl::kLog1p, glsl::kAsinh},
       .vector_prelude = glsl::kAsinhVectors,
       .adjoint = chain<[](Builder& b, ValueId x, ValueId) { return asinh_derivative(b, x); }>,
       .domains = {{-10, 10}},
       .singular = {{{0}}, {{1e30}}, {{-1e30}}},
       .ulp_bound = 4},
      {.kind = OpKind::Acosh,
       .shape = Shape::Elementwise,
       .doc = "Inverse hyperbolic cosine, NaN below 1. Derivative 0 for x <= 1.",
       .cost = 20,
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return std::acosh(x); }); },
       .glsl = function<"dr_acosh">,
       .prelude = {glsl::kLogPart, glsl::kLog, glsl::kLog1p, glsl::kAcosh},
       .vector_prelude = glsl::kAcoshVectors,
       .adjoint = chain<[](Builder& b, ValueId x, ValueId) { return acosh_derivative(b, x); }>,
       .domains = {{1.1, 10}},
       .singular = {{{1}}, {{1e30}}},
       .ulp_bound = 4},
      {.kind = OpKind::Atanh,
       .shape = Shape::Elementwise,
       .doc = "Inverse hyperbolic tangent: Inf at 1, -Inf at -1, NaN beyond. Derivative 0 for |x| >= 1.",
       .cost = 20,
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return std::atanh(x); }); },
       .glsl = function<"dr_atanh">,
       .prelude = {glsl::kLogPart, glsl::kLog1p, glsl::kAtanh},
       .vector_prelude = glsl::kAtanhVectors,
       .adjoint = chain<[](Builder& b, ValueId x, ValueId) { return atanh_derivative(b, x); }>,
       .domains = {{-0.9, 0.9}},
       .singular = {{{0}}, {{1}}, {{-1}}},
       .ulp_bound = 4},
      {.kind = OpKind::Sigmoid,
       .shape = Shape::Elementwise,
       .doc = "1 / (1 + e^-x), with full relative accuracy in both tails, of the derivative too.",
       .cost = 20,
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, sigmoid); },
       .glsl = function<"dr_sigmoid">,
       .prelude = {glsl::kExpPart, glsl::kExp, glsl::kSigmoid},
       .vector_prelude = glsl::kSigmoidVectors,
       // D (1 - D) with 1 - D = sigmoid(-x) computed, not subtracted.
       .adjoint =
           chain<[](Builder& b, ValueId x, ValueId y) { return mul(b, y, apply(b, OpKind::Sigmoid, neg(b, x))); }>,
       .domains = {{-20, 20}},
       .singular = {{{0}}, {{-100}}, {{100}}, {{-10000}}, {{10000}}},
       .ulp_bound = 5},
      {.kind = OpKind::Softplus,
       .shape = Shape::Elementwise,
       .doc = "log(1 + e^x), with full relative accuracy on both sides.",
       .cost = 20,
       .is_function = true,
       .infer = infer1,
       .eval =
           [](const EvalBatch& e) {
             map1(e,
                  [](double x) { return std::isnan(x) ? x : std::max(x, 0.0) + std::log1p(std::exp(-std::abs(x))); });
           },
       .glsl = function<"dr_softplus">,
       .prelude = {glsl::kExpPart, glsl::kExp, glsl::kLogPart, glsl::kLog1p, glsl::kSoftplus},
       .vector_prelude = glsl::kSoftplusVectors,
       .adjoint = chain<[](Builder& b, ValueId x, ValueId) { return apply(b, OpKind::Sigmoid, x); }>,
       .domains = {{-20, 20}},
       .singular = {{{0}}, {{-100}}, {{100}}, {{-10000}}, {{10000}}},
       .ulp_bound = 6},
      {.kind = OpKind::LogAddExp,
       .shape = Shape::Elementwise,
       .doc = "log(e^x + e^y), where neither power is taken alone: of equal infinities that infinity, with half the "
              "derivative each.",
       .cost = 40,
       .is_function = true,
       .infer = infer2,
       .eval = [](const EvalBatch& e) { map2(e, log_add_exp); },
       .glsl = function<"dr_logaddexp">,
       .prelude = {glsl::kExpPart, glsl::kExp, glsl::kLogPart, glsl::kLog1p, glsl::kLogAddExp},
       .vector_prelude = glsl::kLogAddExpVectors,
       .adjoint = log_add_exp_adjoint,
       .domains = {{0.1, 20}, {0.1, 20}},  // without cancellation
       .singular = {{{0, 0}}, {{100, -100}}, {{-10000, -10000}}, {{1e30, 1e30}}, {{-1e30, 1e30}}},
       .ulp_bound = 6},
      {.kind = OpKind::Erf,
       .shape = Shape::Elementwise,
       .doc = "The error function.",
       .cost = 20,
       .is_function = true,
       .infer = infer1,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return std::erf(x); }); },
       .glsl = function<"dr_erf">,
       .prelude = {glsl::kExpPart, glsl::kExp, glsl::kErf},
       .vector_prelude = glsl::kErfVectors,
       .adjoint = chain<[](Builder& b, ValueId x, ValueId) {
         const ValueId bell = apply(b, OpKind::Exp, neg(b, mul(b, x, x)));
         return mul(b, like(b, x, 2 * std::numbers::inv_sqrtpi), bell);
       }>,
       .domains = {{-3, 3}},
       .singular = {{{0}}, {{1}}, {{100}}},
       .ulp_bound = 4},
  };
}

}  // namespace dr::ops
