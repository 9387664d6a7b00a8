// SPDX-License-Identifier: Apache-2.0
// Arithmetic, component by component, of Float, Int and Uint. Integers wrap to 32 bits; nothing of them is undefined.
#include <algorithm>
#include <bit>
#include <charconv>

#include "compiler/ops/families.h"
#include "compiler/ops/prelude.h"
#include "compiler/ops/rules.h"

namespace dr::ops {

using namespace rules;

namespace {

// A NaN loses against a number, as in GLSL's NMin and NMax.
double smaller(double x, double y) { return y < x || std::isnan(x) ? y : x; }
double larger(double x, double y) { return y > x || std::isnan(x) ? y : x; }

// x - y floor(x / y) without its rounding: fmod is exact. In the half-open range from 0 to y.
double floor_mod(double x, double y) {
  if (y == 0) return std::isnan(x) ? x : 0.0;
  double r = std::fmod(x, y);
  if (r != 0 && (r < 0) != (y < 0)) r += y;
  return std::abs(r) >= std::abs(y) ? std::nextafter(y, 0.0) : r;
}

int64_t int_div(int64_t x, int64_t y) { return y == 0 ? 0 : x / y; }
int64_t int_mod(int64_t x, int64_t y) {
  if (y == 0) return 0;
  const int64_t r = x % y;
  return r != 0 && (r < 0) != (y < 0) ? r + y : r;
}

bool is_float(const GlslInput& in) { return in.result_type.is_float(); }

// k where each component of an integer is the number 2^k: "4", "16u", "ivec2(8, 8)".
std::optional<int> power_of_two(std::string_view text) {
  if (const size_t open = text.find('('); open != std::string_view::npos && text.ends_with(')'))
    text = text.substr(open + 1, text.size() - open - 2);
  std::optional<int> power;
  while (!text.empty()) {
    uint32_t number = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
    if (error != std::errc() || !std::has_single_bit(number)) return std::nullopt;
    const int here = std::countr_zero(number);
    if (power && *power != here) return std::nullopt;
    power = here;
    text.remove_prefix(static_cast<size_t>(end - text.data()));
    if (text.starts_with('u')) text.remove_prefix(1);
    if (text.starts_with(", "))
      text.remove_prefix(2);
    else if (!text.empty())
      return std::nullopt;
  }
  return power;
}
std::optional<int> by_power_of_two(const GlslInput& in) {
  const auto power =
      is_float(in) || in.operand_types[1] != in.result_type ? std::nullopt : power_of_two(in.operands[1]);
  return power && *power < 31 ? power : std::nullopt;
}

// Processors divide a vector's integers one after another, and shift and mask them at once.
std::string integer_quotient(const GlslInput& in, int power) {
  const std::string& x = in.operands[0];
  const std::string by = " >> " + std::to_string(power) + ")";
  if (in.result_type.scalar == Scalar::Uint) return "(" + x + by;
  // Rounded towards 0: of a negative number what is left is carried.
  const std::string rest = std::to_string((int64_t{1} << power) - 1);
  return "((" + x + " + ((" + x + " >> 31) & " + rest + "))" + by;
}
std::string integer_rest(const GlslInput& in, int power) {
  const std::string rest = std::to_string((int64_t{1} << power) - 1);
  return "(" + in.operands[0] + " & " + rest + (in.result_type.scalar == Scalar::Uint ? "u)" : ")");
}

using Texts = std::vector<std::string_view>;

Texts with_vectors(const GlslInput& in, Texts texts, std::string_view vectors) {
  if (!in.result_type.is_scalar()) texts.push_back(vectors);
  return texts;
}

Texts integer_texts(const GlslInput& in, std::string_view of_int, std::string_view int_vectors,
                    std::string_view of_uint, std::string_view uint_vectors) {
  const bool is_int = in.result_type.scalar == Scalar::Int;
  return with_vectors(in, {is_int ? of_int : of_uint}, is_int ? int_vectors : uint_vectors);
}

AdjointOutput div_adjoint(const AdjointInput& in) {
  Builder& b = in.builder;
  // 1 / y, and -(x / y) / y: no square or quotient that leaves the range before the result does. Both 0 at y = 0.
  const ValueId y = in.operands[1];
  const ValueId is_zero = apply(b, OpKind::Equal, y, zero_like(b, y));
  const ValueId in_x = drop_where(b, is_zero, div(b, like(b, y, 1.0), y));
  const ValueId in_y = drop_where(b, is_zero, div(b, in.result, y));
  return {smul(b, in.adjoint, in_x), neg(b, smul(b, in.adjoint, in_y))};
}

AdjointOutput mod_adjoint(const AdjointInput& in) {
  Builder& b = in.builder;
  const ValueId x = in.operands[0], y = in.operands[1];
  const ValueId is_zero = apply(b, OpKind::Equal, y, zero_like(b, y));
  const ValueId turns = drop_where(b, is_zero, apply(b, OpKind::Floor, div(b, x, y)));
  return {in.adjoint, neg(b, smul(b, in.adjoint, turns))};
}

// The operand that is the result has the adjoint; both have half of it on a tie.
AdjointOutput extreme_adjoint(const AdjointInput& in) {
  Builder& b = in.builder;
  const ValueId is_x = apply(b, OpKind::Equal, in.result, in.operands[0]);
  const ValueId is_y = apply(b, OpKind::Equal, in.result, in.operands[1]);
  const ValueId half = smul(b, in.adjoint, like(b, in.adjoint, 0.5));
  return {keep_where(b, is_x, select(b, is_y, half, in.adjoint)),
          keep_where(b, is_y, select(b, is_x, half, in.adjoint))};
}

// clamp is min(max(x, low), high), for low > high too: then it is high.
AdjointOutput clamp_adjoint(const AdjointInput& in) {
  Builder& b = in.builder;
  const ValueId x = in.operands[0], low = in.operands[1], high = in.operands[2];
  const ValueId above_low = apply(b, OpKind::LessEqual, low, x);
  const ValueId ordered = apply(b, OpKind::LessEqual, low, high);
  const ValueId inside = apply(b, OpKind::LogicalAnd, above_low, apply(b, OpKind::LessEqual, x, high));
  const ValueId unordered = apply(b, OpKind::LogicalNot, ordered);
  const ValueId is_high = apply(b, OpKind::LogicalOr, apply(b, OpKind::Less, high, x), unordered);
  const ValueId is_low = apply(b, OpKind::LogicalAnd, apply(b, OpKind::LogicalNot, above_low), ordered);
  return {keep_where(b, inside, in.adjoint), keep_where(b, is_low, in.adjoint), keep_where(b, is_high, in.adjoint)};
}

// g * x, and 0 where g is 0 whatever x is. Gradients of long chains have thousands: neither a branch nor a call.
std::string smul_glsl(const GlslInput& in) {
  const auto product = [](const Type& type, const std::string& g, const std::string& x) {
    const std::string zero = type.is_scalar() ? "0.0" : type.str() + "(0.0)";
    const std::string is_zero = type.is_scalar() ? g + " == 0.0" : "equal(" + g + ", " + zero + ")";
    return "mix(" + g + " * " + x + ", " + zero + ", " + is_zero + ")";
  };
  const Type type = in.result_type;
  if (!type.is_matrix()) return product(type, in.operands[0], in.operands[1]);
  std::string text = type.str() + "(";
  for (int k = 0; k < type.cols; ++k) {
    const std::string column = "[" + std::to_string(k) + "]";
    text +=
        (k > 0 ? ", " : "") + product({type.scalar, type.rows, 1}, in.operands[0] + column, in.operands[1] + column);
  }
  return text + ")";
}

}  // namespace

std::vector<OpInfo> arithmetic_ops() {
  return {
      {.kind = OpKind::Add,
       .shape = Shape::Elementwise,
       .doc = "x + y, of matrices too.",
       .cost = 1,
       .commutes = true,
       .light = true,
       .recompute = Recompute::OfConstant,
       .folds = Folds::Rounds,
       .zero = ZeroWhere::AllAre,
       .infer = component_wise<2, kNumbers | kMatrices>,
       .eval =
           [](const EvalBatch& e) {
             numbers2(
                 e, [](double x, double y) { return x + y; }, [](int64_t x, int64_t y) { return x + y; });
           },
       .glsl = infix_of<"+">,
       .adjoint = [](const AdjointInput& in) -> AdjointOutput {
         return {in.adjoint, in.adjoint};
       },
       .domains = {{-3, 3}, {-3, 3}},
       .singular = {{{0, 0}}},
       .ulp_bound = 0.5},
      {.kind = OpKind::Sub,
       .shape = Shape::Elementwise,
       .doc = "x - y, of matrices too.",
       .cost = 1,
       .light = true,
       .recompute = Recompute::OfConstant,
       .folds = Folds::Rounds,
       .zero = ZeroWhere::AllAre,
       .infer = component_wise<2, kNumbers | kMatrices>,
       .eval =
           [](const EvalBatch& e) {
             numbers2(
                 e, [](double x, double y) { return x - y; }, [](int64_t x, int64_t y) { return x - y; });
           },
       .glsl = infix_of<"-">,
       .adjoint = [](const AdjointInput& in) -> AdjointOutput {
         return {in.adjoint, neg(in.builder, in.adjoint)};
       },
       .domains = {{-3, 3}, {-3, 3}},
       .singular = {{{0, 0}}},
       .ulp_bound = 0.5},
      {.kind = OpKind::Mul,
       .shape = Shape::Elementwise,
       .doc = "x * y, component by component.",
       .cost = 1,
       .commutes = true,
       .light = true,
       .recompute = Recompute::OfConstant,
       .folds = Folds::Rounds,
       .zero = ZeroWhere::AFactorIs,
       .infer = component_wise<2, kNumbers>,
       .eval =
           [](const EvalBatch& e) {
             numbers2(
                 e, [](double x, double y) { return x * y; },
                 [](int64_t x, int64_t y) {
                   return static_cast<int64_t>(static_cast<uint64_t>(x) * static_cast<uint64_t>(y));
                 });
           },
       .glsl = infix_of<"*">,
       .adjoint = [](const AdjointInput& in) -> AdjointOutput {
         return {smul(in.builder, in.adjoint, in.operands[1]), smul(in.builder, in.adjoint, in.operands[0])};
       },
       .domains = {{-3, 3}, {-3, 3}},
       .singular = {{{0, 0}}, {{0, 1}}},
       .ulp_bound = 0.5},
      {.kind = OpKind::Div,
       .shape = Shape::Elementwise,
       .doc = "x / y. Floats: by zero as IEEE says, with derivative 0. Integers: truncates, by zero gives 0.",
       .infer = component_wise<2, kNumbers>,
       .eval =
           [](const EvalBatch& e) {
             numbers2(
                 e, [](double x, double y) { return x / y; }, int_div);
           },
       .glsl =
           [](const GlslInput& in) {
             if (const auto power = by_power_of_two(in)) return integer_quotient(in, *power);
             return call(is_float(in) ? "dr_quotient" : "dr_div", in);
           },
       .prelude_of = [](const GlslInput& in) -> Texts {
         if (by_power_of_two(in)) return {};
         if (is_float(in)) return with_vectors(in, {glsl::kQuotient}, glsl::kQuotientVectors);
         return integer_texts(in, glsl::kIntDiv, glsl::kIntDivVectors, glsl::kUintDiv, glsl::kUintDivVectors);
       },
       .adjoint = div_adjoint,
       .domains = {{-3, 3}, {0.25, 3}},
       .singular = {{{0, 1}}, {{1, 0}}, {{0, 0}}, {{1, 1e-30}}, {{1e-30, 1e30}}},
       .ulp_bound = 2.5},
      {.kind = OpKind::Mod,
       .shape = Shape::Elementwise,
       .doc =
           "x - y floor(x / y), from 0 to y without y; by zero gives 0. d/dx is 1, d/dy is -floor(x / y), 0 at y = 0.",
       .infer = component_wise<2, kNumbers>,
       .eval = [](const EvalBatch& e) { numbers2(e, floor_mod, int_mod); },
       .glsl =
           [](const GlslInput& in) {
             if (const auto power = by_power_of_two(in)) return integer_rest(in, *power);
             return call("dr_mod", in);
           },
       .prelude_of = [](const GlslInput& in) -> Texts {
         if (by_power_of_two(in)) return {};
         if (is_float(in)) return with_vectors(in, {glsl::kQuotient, glsl::kMod}, glsl::kModVectors);
         return integer_texts(in, glsl::kIntMod, glsl::kIntModVectors, glsl::kUintMod, glsl::kUintModVectors);
       },
       .adjoint = mod_adjoint,
       .domains = {{-10, 10}, {0.5, 3}},
       .singular = {{{0, 1}}, {{3, 1}}, {{1, 0}}, {{-1e-9, 1}}},
       .ulp_bound = 4},
      {.kind = OpKind::Neg,
       .shape = Shape::Elementwise,
       .doc = "-x, of matrices too.",
       .cost = 1,
       .light = true,
       .recompute = Recompute::Always,
       .folds = Folds::Moves,
       .zero = ZeroWhere::FirstIs,
       .infer = component_wise<1, kNumbers | kMatrices>,
       .eval =
           [](const EvalBatch& e) {
             numbers1(
                 e, [](double x) { return -x; }, [](int64_t x) { return -x; });
           },
       .glsl =
           [](const GlslInput& in) {
             return in.result_type.scalar == Scalar::Uint ? "0u - " + in.operands[0] : prefix(in, "-");
           },
       .adjoint = [](const AdjointInput& in) -> AdjointOutput { return {neg(in.builder, in.adjoint)}; },
       .domains = {{-3, 3}},
       .singular = {{{0}}},
       .ulp_bound = 0},
      {.kind = OpKind::Abs,
       .shape = Shape::Elementwise,
       .doc = "Absolute value. Derivative 0 at 0; the least integer is its own.",
       .cost = 1,
       .recompute = Recompute::Always,
       .folds = Folds::Moves,
       .zero = ZeroWhere::FirstIs,
       .infer = component_wise<1, kNumbers>,
       .eval =
           [](const EvalBatch& e) {
             numbers1(
                 e, [](double x) { return std::abs(x); }, [](int64_t x) { return std::abs(x); });
           },
       .glsl = [](const GlslInput& in) -> std::string {
         switch (in.result_type.scalar) {
           case Scalar::Float: return call("abs", in);
           case Scalar::Int: return "max(" + in.operands[0] + ", " + prefix(in, "-") + ")";
           case Scalar::Uint: return in.operands[0];
           case Scalar::Bool: break;
         }
         DR_ICE("abs of a bool");
       },
       .adjoint = chain<[](Builder& b, ValueId x, ValueId) { return apply(b, OpKind::Sign, x); }>,
       .domains = {{-3, 3}},
       .singular = {{{0}}},
       .ulp_bound = 0},
      {.kind = OpKind::Sign,
       .shape = Shape::Elementwise,
       .doc = "-1, 0 or 1. Derivative 0.",
       .no_gradient = "$ is constant between its jumps, its derivative is zero",
       .infer = component_wise<1, kNumbers>,
       .eval =
           [](const EvalBatch& e) {
             numbers1(
                 e, [](double x) { return static_cast<double>((x > 0) - (x < 0)); },
                 [](int64_t x) { return static_cast<int64_t>((x > 0) - (x < 0)); });
           },
       .glsl =
           [](const GlslInput& in) {
             return in.result_type.scalar == Scalar::Uint ? "min(" + in.operands[0] + ", 1u)" : call("sign", in);
           },
       .differentiable = false,
       .domains = {{-3, 3}},
       .singular = {{{0}}},
       .ulp_bound = 0},
      {.kind = OpKind::Min,
       .shape = Shape::Elementwise,
       .doc = "The smaller operand; a NaN loses. On a tie both have half the derivative.",
       .cost = 1,
       .infer = component_wise<2, kNumbers>,
       .eval = [](const EvalBatch& e) { numbers2(e, smaller, [](int64_t x, int64_t y) { return std::min(x, y); }); },
       .glsl = [](const GlslInput& in) { return call(is_float(in) ? "dr_min" : "min", in); },
       .prelude_of = [](const GlslInput& in) -> Texts {
         if (!is_float(in)) return {};
         return with_vectors(in, {glsl::kIsNan, glsl::kMin}, glsl::kMinVectors);
       },
       .adjoint = extreme_adjoint,
       .domains = {{-3, 3}, {-3, 3}},
       .singular = {{{0, 0}}, {{1, 1}}},
       .ulp_bound = 0},
      {.kind = OpKind::Max,
       .shape = Shape::Elementwise,
       .doc = "The larger operand; a NaN loses. On a tie both have half the derivative.",
       .cost = 1,
       .infer = component_wise<2, kNumbers>,
       .eval = [](const EvalBatch& e) { numbers2(e, larger, [](int64_t x, int64_t y) { return std::max(x, y); }); },
       .glsl = [](const GlslInput& in) { return call(is_float(in) ? "dr_max" : "max", in); },
       .prelude_of = [](const GlslInput& in) -> Texts {
         if (!is_float(in)) return {};
         return with_vectors(in, {glsl::kIsNan, glsl::kMax}, glsl::kMaxVectors);
       },
       .adjoint = extreme_adjoint,
       .domains = {{-3, 3}, {-3, 3}},
       .singular = {{{0, 0}}, {{1, 1}}},
       .ulp_bound = 0},
      {.kind = OpKind::Clamp,
       .shape = Shape::Elementwise,
       .doc = "min(max(x, low), high). x has the derivative from low to high inclusive, outside the bound has it.",
       .cost = 1,
       .infer = component_wise<3, kNumbers>,
       .eval =
           [](const EvalBatch& e) {
             map3(e, [](double x, double low, double high) { return smaller(larger(x, low), high); });
           },
       .glsl =
           [](const GlslInput& in) {
             const std::string prefix = is_float(in) ? "dr_" : "";
             return prefix + "min(" + prefix + "max(" + in.operands[0] + ", " + in.operands[1] + "), " +
                    in.operands[2] + ")";
           },
       .prelude_of = [](const GlslInput& in) -> Texts {
         if (!is_float(in)) return {};
         if (in.result_type.is_scalar()) return {glsl::kIsNan, glsl::kMin, glsl::kMax};
         return {glsl::kIsNan, glsl::kMin, glsl::kMinVectors, glsl::kMax, glsl::kMaxVectors};
       },
       .adjoint = clamp_adjoint,
       .domains = {{-3, 3}, {-2, -0.5}, {0.5, 2}},
       .singular = {{{-1, -1, 1}}, {{1, -1, 1}}, {{0, 0, 0}}, {{0, 1, -1}}},
       .ulp_bound = 0},
      {.kind = OpKind::SMul,
       .shape = Shape::Elementwise,
       .doc = "g * x, and 0 where g is 0 whatever x is: the product of an adjoint and a derivative. Of matrices "
              "component by "
              "component.",
       .cost = 1,
       .light = true,
       .recompute = Recompute::OfConstant,
       .folds = Folds::Rounds,
       .zero = ZeroWhere::FirstIs,
       .infer = component_wise<2, kFloats | kMatrices>,
       .eval = [](const EvalBatch& e) { map2(e, [](double g, double x) { return g == 0 ? 0.0 : g * x; }); },
       .glsl = smul_glsl,
       .adjoint = [](const AdjointInput& in) -> AdjointOutput {
         return {smul(in.builder, in.adjoint, in.operands[1]), smul(in.builder, in.adjoint, in.operands[0])};
       },
       .domains = {{-3, 3}, {-3, 3}},
       .singular = {{{0, 0}}, {{0, 1}}},
       .ulp_bound = 0.5},
  };
}

}  // namespace dr::ops
