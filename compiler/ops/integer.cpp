// SPDX-License-Identifier: Apache-2.0
// Bits of Int and Uint, component by component, and of floats. No derivatives.
#include <bit>

#include "compiler/ops/families.h"
#include "compiler/ops/prelude.h"
#include "compiler/ops/rules.h"

namespace dr::ops {

using namespace rules;

namespace {

// Shift counts are taken modulo 32, as the mask says that GLSL gets.
std::string shift(const GlslInput& in, std::string_view op) {
  const std::string mask = in.operand_types[1].scalar == Scalar::Uint ? "31u" : "31";
  return in.operands[0] + " " + std::string(op) + " (" + in.operands[1] + " & " + mask + ")";
}

template <class G>
void bits2(const EvalBatch& e, G g) {
  const Type type = e.result_type;
  map2(e, [&](double x, double y) { return wrap(type, g(integer(x), integer(y))); });
}

// One operand of Int or Uint, the result is Int.
InferResult infer_to_int(const InferInput& in) {
  InferResult same = same_types(in, 1, kInts);
  if (auto* types = std::get_if<std::vector<ResultType>>(&same)) {
    (*types)[0].type = (*types)[0].type.with_scalar(Scalar::Int);
  }
  return same;
}

template <class G>
void of_bits(const EvalBatch& e, G g) {
  const Type type = e.result_type;
  map1(e, [&](double x) { return wrap(type, g(static_cast<uint32_t>(integer(x)))); });
}

// The highest bit of a negative Int is the highest one that differs from its sign.
void eval_find_msb(const EvalBatch& e) {
  const bool is_int = e.operand_types[0].scalar == Scalar::Int;
  of_bits(e, [&](uint32_t x) { return 31 - std::countl_zero(is_int && x >> 31 != 0 ? ~x : x); });
}

uint32_t reversed(uint32_t x) {
  uint32_t y = 0;
  for (int k = 0; k < 32; ++k) y |= ((x >> k) & 1) << (31 - k);
  return y;
}

void eval_mul_high(const EvalBatch& e) {
  // Products of two numbers of 32 bits fit 64, those of Int and of Uint each in their kind.
  if (e.result_type.scalar == Scalar::Int) return bits2(e, [](int64_t x, int64_t y) { return (x * y) >> 32; });
  bits2(e, [](int64_t x, int64_t y) {
    return static_cast<int64_t>((static_cast<uint64_t>(x) * static_cast<uint64_t>(y)) >> 32);
  });
}

InferResult infer_bitcast(const InferInput& in) {
  if (std::string wrong = expect_operands(in, 1); !wrong.empty()) return wrong;
  if (std::string wrong = expect_ints(in.attrs, 1); !wrong.empty()) return wrong;
  if (std::string wrong = expect_accepted(in.operands, kNumbers); !wrong.empty()) return wrong;
  if (in.attrs.ints[0] <= static_cast<int64_t>(Scalar::Bool) || in.attrs.ints[0] > static_cast<int64_t>(Scalar::Float))
    return "there is no number of 32 bits of that element type";
  const auto to = static_cast<Scalar>(in.attrs.ints[0]);
  const Type type = in.operands[0].type;
  if (type.is_float() == (to == Scalar::Float)) return "takes the bits of a float, or makes a float of bits";
  return one(type.with_scalar(to), in.operands[0].extent);
}

void eval_bitcast(const EvalBatch& e) {
  const Type type = e.result_type;
  if (type.is_float()) {
    return map1(e,
                [](double x) { return static_cast<double>(std::bit_cast<float>(static_cast<uint32_t>(integer(x)))); });
  }
  map1(e, [&](double x) { return wrap(type, std::bit_cast<uint32_t>(static_cast<float>(x))); });
}

std::string bitcast_glsl(const GlslInput& in) {
  if (!in.result_type.is_float())
    return call(in.result_type.scalar == Scalar::Int ? "floatBitsToInt" : "floatBitsToUint", in);
  return call(in.operand_types[0].scalar == Scalar::Int ? "intBitsToFloat" : "uintBitsToFloat", in);
}

}  // namespace

std::vector<OpInfo> integer_ops() {
  constexpr auto infer2 = component_wise<2, kInts>;
  return {
      {.kind = OpKind::BitAnd,
       .shape = Shape::Elementwise,
       .doc = "Bits set in both.",
       .commutes = true,
       .infer = infer2,
       .eval = [](const EvalBatch& e) { bits2(e, [](int64_t x, int64_t y) { return x & y; }); },
       .glsl = infix_of<"&">,
       .differentiable = false,
       .ulp_bound = 0},
      {.kind = OpKind::BitOr,
       .shape = Shape::Elementwise,
       .doc = "Bits set in either.",
       .commutes = true,
       .infer = infer2,
       .eval = [](const EvalBatch& e) { bits2(e, [](int64_t x, int64_t y) { return x | y; }); },
       .glsl = infix_of<"|">,
       .differentiable = false,
       .ulp_bound = 0},
      {.kind = OpKind::BitXor,
       .shape = Shape::Elementwise,
       .doc = "Bits set in one of both.",
       .commutes = true,
       .infer = infer2,
       .eval = [](const EvalBatch& e) { bits2(e, [](int64_t x, int64_t y) { return x ^ y; }); },
       .glsl = infix_of<"^">,
       .differentiable = false,
       .ulp_bound = 0},
      {.kind = OpKind::BitNot,
       .shape = Shape::Elementwise,
       .doc = "Bits not set.",
       .infer = component_wise<1, kInts>,
       .eval =
           [](const EvalBatch& e) {
             const Type type = e.result_type;
             map1(e, [&](double x) { return wrap(type, ~integer(x)); });
           },
       .glsl = [](const GlslInput& in) { return prefix(in, "~"); },
       .differentiable = false,
       .ulp_bound = 0},
      {.kind = OpKind::ShiftLeft,
       .shape = Shape::Elementwise,
       .doc = "x shifted up by the low five bits of y.",
       .infer = infer2,
       .eval =
           [](const EvalBatch& e) {
             bits2(e, [](int64_t x, int64_t y) { return static_cast<int64_t>(static_cast<uint64_t>(x) << (y & 31)); });
           },
       .glsl = [](const GlslInput& in) { return shift(in, "<<"); },
       .differentiable = false,
       .ulp_bound = 0},
      {.kind = OpKind::ShiftRight,
       .shape = Shape::Elementwise,
       .doc = "x shifted down by the low five bits of y; an Int keeps its sign.",
       .infer = infer2,
       .eval = [](const EvalBatch& e) { bits2(e, [](int64_t x, int64_t y) { return x >> (y & 31); }); },
       .glsl = [](const GlslInput& in) { return shift(in, ">>"); },
       .differentiable = false,
       .ulp_bound = 0},
      {.kind = OpKind::BitCount,
       .shape = Shape::Elementwise,
       .doc = "How many bits are set.",
       .infer = infer_to_int,
       .eval = [](const EvalBatch& e) { of_bits(e, [](uint32_t x) { return std::popcount(x); }); },
       .glsl = function<"bitCount">,
       .differentiable = false,
       .ulp_bound = 0},
      {.kind = OpKind::FindLsb,
       .shape = Shape::Elementwise,
       .doc = "The number of the lowest bit set, -1 for 0.",
       .infer = infer_to_int,
       .eval = [](const EvalBatch& e) { of_bits(e, [](uint32_t x) { return x == 0 ? -1 : std::countr_zero(x); }); },
       .glsl = function<"findLSB">,
       .differentiable = false,
       .ulp_bound = 0},
      {.kind = OpKind::FindMsb,
       .shape = Shape::Elementwise,
       .doc = "The number of the highest bit set, of a negative Int the highest not set; -1 where there is none.",
       .infer = infer_to_int,
       .eval = eval_find_msb,
       .glsl = function<"findMSB">,
       .differentiable = false,
       .ulp_bound = 0},
      {.kind = OpKind::BitReverse,
       .shape = Shape::Elementwise,
       .doc = "The bits in the opposite order.",
       .infer = component_wise<1, kInts>,
       .eval = [](const EvalBatch& e) { of_bits(e, reversed); },
       .glsl = function<"bitfieldReverse">,
       .differentiable = false,
       .ulp_bound = 0},
      {.kind = OpKind::MulHigh,
       .shape = Shape::Elementwise,
       .doc = "The high 32 of the 64 bits of x * y.",
       .infer = infer2,
       .eval = eval_mul_high,
       .glsl = function<"dr_mul_high">,
       .prelude_of = [](const GlslInput& in) -> std::vector<std::string_view> {
         const bool is_int = in.result_type.scalar == Scalar::Int;
         std::vector<std::string_view> texts{is_int ? glsl::kIntMulHigh : glsl::kUintMulHigh};
         if (!in.result_type.is_scalar())
           texts.push_back(is_int ? glsl::kIntMulHighVectors : glsl::kUintMulHighVectors);
         return texts;
       },
       .differentiable = false,
       .ulp_bound = 0},
      {.kind = OpKind::Bitcast,
       .shape = Shape::Elementwise,
       .doc = "The bits of a float32 as an integer, and back; float64 is rounded first. A device may take a subnormal "
              "for 0, and the bits of a NaN are any NaN's.",
       .infer = infer_bitcast,
       .eval = eval_bitcast,
       .glsl = bitcast_glsl,
       .differentiable = false,
       .domains = {{-10, 10}},
       .singular = {{{0}}, {{1}}},
       .ulp_bound = 0},
  };
}

}  // namespace dr::ops
