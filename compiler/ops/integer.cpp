// SPDX-License-Identifier: Apache-2.0
// Bits of Int and Uint, component by component. No derivatives.
#include "compiler/ops/families.h"
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

}  // namespace

std::vector<OpInfo> integer_ops() {
  constexpr auto infer2 = component_wise<2, kInts>;
  return {
      {.kind = OpKind::BitAnd,
       .shape = Shape::Elementwise,
       .doc = "Bits set in both.",
       .infer = infer2,
       .eval = [](const EvalBatch& e) { bits2(e, [](int64_t x, int64_t y) { return x & y; }); },
       .glsl = infix_of<"&">,
       .differentiable = false,
       .ulp_bound = 0},
      {.kind = OpKind::BitOr,
       .shape = Shape::Elementwise,
       .doc = "Bits set in either.",
       .infer = infer2,
       .eval = [](const EvalBatch& e) { bits2(e, [](int64_t x, int64_t y) { return x | y; }); },
       .glsl = infix_of<"|">,
       .differentiable = false,
       .ulp_bound = 0},
      {.kind = OpKind::BitXor,
       .shape = Shape::Elementwise,
       .doc = "Bits set in one of both.",
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
  };
}

}  // namespace dr::ops
