// SPDX-License-Identifier: Apache-2.0
// Comparison, logic, choice and conversion, component by component.
#include "compiler/ops/families.h"
#include "compiler/ops/prelude.h"
#include "compiler/ops/rules.h"

namespace dr::ops {

using namespace rules;

namespace {

// GLSL compares scalars by operators and vectors by functions.
template <Name op, Name function_name>
std::string compare(const GlslInput& in) {
  return in.result_type.is_scalar() ? infix(in, op.text) : call(function_name.text, in);
}

// GLSL has no logic of bvecs but that of their components.
std::string logic(const GlslInput& in, std::string_view op) {
  if (in.result_type.is_scalar()) return infix(in, op);
  std::string text = in.result_type.str() + "(";
  for (int c = 0; c < in.result_type.rows; ++c) {
    const std::string part = std::string(".") + "xyzw"[c];
    text += (c > 0 ? ", " : "") + in.operands[0] + part + " " + std::string(op) + " " + in.operands[1] + part;
  }
  return text + ")";
}

InferResult infer_select(const InferInput& in) {
  if (std::string wrong = expect_operands(in, 3); !wrong.empty()) return wrong;
  const Type condition = in.operands[0].type;
  if (std::string wrong = expect_equal_types(in.operands[1], in.operands[2]); !wrong.empty()) return wrong;
  const Type type = in.operands[1].type;
  if (condition != ir::kBool && (!condition.is_bool() || type.is_matrix() || condition.rows != type.rows)) {
    return "the condition of a choice of " + type.str() + " cannot be " + condition.str();
  }
  auto extent = common_extent(in.operands);
  if (auto* wrong = std::get_if<std::string>(&extent)) return std::move(*wrong);
  return one(type, std::get<Extent>(extent));
}

void eval_select(const EvalBatch& e) {
  const size_t condition_planes = static_cast<size_t>(e.operand_types[0].components());
  const auto planes = static_cast<size_t>(e.result_type.components());
  for (size_t c = 0; c < planes; ++c) {
    const double* condition = e.operands[0] + (condition_planes == 1 ? 0 : c * e.n);
    for (size_t i = 0; i < e.n; ++i) {
      e.result[c * e.n + i] = condition[i] != 0 ? e.operands[1][c * e.n + i] : e.operands[2][c * e.n + i];
    }
  }
}

std::string select_glsl(const GlslInput& in) {
  if (in.operand_types[0].is_scalar()) return in.operands[0] + " ? " + in.operands[1] + " : " + in.operands[2];
  return "mix(" + in.operands[2] + ", " + in.operands[1] + ", " + in.operands[0] + ")";
}

InferResult infer_convert(const InferInput& in) {
  if (std::string wrong = expect_operands(in, 1); !wrong.empty()) return wrong;
  if (std::string wrong = expect_ints(in.attrs, 1); !wrong.empty()) return wrong;
  if (std::string wrong = expect_accepted(in.operands, kNumbers | kBools); !wrong.empty()) return wrong;
  if (in.attrs.ints[0] < 0 || in.attrs.ints[0] > static_cast<int64_t>(Scalar::Float))
    return "there is no such element type";
  return one(in.operands[0].type.with_scalar(static_cast<Scalar>(in.attrs.ints[0])), in.operands[0].extent);
}

double saturate(double x, double low, double high) {
  if (std::isnan(x)) return 0.0;
  return x <= low ? low : (x >= high ? high : std::trunc(x));
}

void eval_convert(const EvalBatch& e) {
  const Type from = e.operand_types[0];
  const Type to = e.result_type;
  switch (to.scalar) {
    case Scalar::Float: return map1(e, [](double x) { return x; });
    case Scalar::Bool: return map1(e, [](double x) { return x < 0 || x > 0 ? 1.0 : 0.0; });
    case Scalar::Int:
      if (from.is_float()) return map1(e, [](double x) { return saturate(x, -2147483648.0, 2147483647.0); });
      break;
    case Scalar::Uint:
      if (from.is_float()) return map1(e, [](double x) { return saturate(x, 0.0, 4294967295.0); });
      break;
  }
  map1(e, [&](double x) { return wrap(to, integer(x)); });
}

std::string convert_glsl(const GlslInput& in) {
  const Type from = in.operand_types[0];
  const Type to = in.result_type;
  if (from == to) return in.operands[0];
  if (from.scalar == Scalar::Uint && to.is_float()) return call("dr_to_float", in);
  if (!from.is_float()) return call(to.str(), in);
  return call(to.is_bool() ? "dr_to_bool" : to.scalar == Scalar::Int ? "dr_to_int" : "dr_to_uint", in);
}

std::vector<std::string_view> convert_prelude(const GlslInput& in) {
  const auto texts = [&](std::string_view scalar, std::string_view vectors) -> std::vector<std::string_view> {
    if (in.result_type.is_scalar()) return {scalar};
    return {scalar, vectors};
  };
  if (in.operand_types[0].scalar == Scalar::Uint && in.result_type.is_float())
    return texts(glsl::kUintToFloat, glsl::kUintToFloatVectors);
  if (!in.operand_types[0].is_float() || in.result_type.is_float()) return {};
  if (in.result_type.is_bool()) return texts(glsl::kFloatToBool, glsl::kFloatToBoolVectors);
  if (in.result_type.scalar == Scalar::Int) return texts(glsl::kFloatToInt, glsl::kFloatToIntVectors);
  return texts(glsl::kFloatToUint, glsl::kFloatToUintVectors);
}

double truth(bool holds) { return holds ? 1.0 : 0.0; }

}  // namespace

std::vector<OpInfo> logic_ops() {
  constexpr auto compare_numbers = [](const InferInput& in) { return comparison(in, kNumbers); };
  constexpr auto compare_anything = [](const InferInput& in) { return comparison(in, kNumbers | kBools); };
  return {
      {.kind = OpKind::Less,
       .shape = Shape::Elementwise,
       .doc = "x < y; false with a NaN.",
       .cost = 1,
       .light = true,
       .infer = compare_numbers,
       .eval = [](const EvalBatch& e) { map2(e, [](double x, double y) { return truth(x < y); }); },
       .glsl = compare<"<", "lessThan">,
       .differentiable = false,
       .domains = {{-3, 3}, {-3, 3}},
       .singular = {{{0, 0}}},
       .ulp_bound = 0},
      {.kind = OpKind::LessEqual,
       .shape = Shape::Elementwise,
       .doc = "x <= y; false with a NaN.",
       .cost = 1,
       .light = true,
       .infer = compare_numbers,
       .eval = [](const EvalBatch& e) { map2(e, [](double x, double y) { return truth(x <= y); }); },
       .glsl = compare<"<=", "lessThanEqual">,
       .differentiable = false,
       .domains = {{-3, 3}, {-3, 3}},
       .singular = {{{0, 0}}},
       .ulp_bound = 0},
      {.kind = OpKind::Equal,
       .shape = Shape::Elementwise,
       .doc = "x = y; false with a NaN. Vectors component by component.",
       .cost = 1,
       .commutes = true,
       .light = true,
       .infer = compare_anything,
       .eval = [](const EvalBatch& e) { map2(e, [](double x, double y) { return truth(x == y); }); },
       .glsl = compare<"==", "equal">,
       .differentiable = false,
       .domains = {{-3, 3}, {-3, 3}},
       .singular = {{{0, 0}}},
       .ulp_bound = 0},
      {.kind = OpKind::NotEqual,
       .shape = Shape::Elementwise,
       .doc = "Not x = y; true with a NaN. Vectors component by component.",
       .cost = 1,
       .commutes = true,
       .light = true,
       .infer = compare_anything,
       .eval = [](const EvalBatch& e) { map2(e, [](double x, double y) { return truth(x != y); }); },
       .glsl = compare<"!=", "notEqual">,
       .differentiable = false,
       .domains = {{-3, 3}, {-3, 3}},
       .singular = {{{0, 0}}},
       .ulp_bound = 0},
      {.kind = OpKind::LogicalAnd,
       .shape = Shape::Elementwise,
       .doc = "x and y; both are evaluated.",
       .cost = 1,
       .commutes = true,
       .infer = component_wise<2, kBools>,
       .eval = [](const EvalBatch& e) { map2(e, [](double x, double y) { return truth(x != 0 && y != 0); }); },
       .glsl = [](const GlslInput& in) { return logic(in, "&&"); },
       .differentiable = false,
       .ulp_bound = 0},
      {.kind = OpKind::LogicalOr,
       .shape = Shape::Elementwise,
       .doc = "x or y; both are evaluated.",
       .cost = 1,
       .commutes = true,
       .infer = component_wise<2, kBools>,
       .eval = [](const EvalBatch& e) { map2(e, [](double x, double y) { return truth(x != 0 || y != 0); }); },
       .glsl = [](const GlslInput& in) { return logic(in, "||"); },
       .differentiable = false,
       .ulp_bound = 0},
      {.kind = OpKind::LogicalNot,
       .shape = Shape::Elementwise,
       .doc = "Not x.",
       .cost = 1,
       .infer = component_wise<1, kBools>,
       .eval = [](const EvalBatch& e) { map1(e, [](double x) { return truth(x == 0); }); },
       .glsl = [](const GlslInput& in) { return in.result_type.is_scalar() ? prefix(in, "!") : call("not", in); },
       .differentiable = false,
       .ulp_bound = 0},
      {.kind = OpKind::Select,
       .shape = Shape::Elementwise,
       .doc = "a where c holds, b elsewhere; both are evaluated. The one not chosen has derivative 0, whatever it is.",
       .cost = 1,
       .light = true,
       .folds = Folds::Moves,
       .zero = ZeroWhere::BothSidesAre,
       .no_gradient = "the condition of $ has no derivative",
       .infer = infer_select,
       .eval = eval_select,
       .glsl = select_glsl,
       .adjoint = [](const AdjointInput& in) -> AdjointOutput {
         const ValueId zero = zero_like(in.builder, in.adjoint);
         return {kNoAdjoint, select(in.builder, in.operands[0], in.adjoint, zero),
                 select(in.builder, in.operands[0], zero, in.adjoint)};
       },
       .domains = {{0, 2}, {-3, 3}, {-3, 3}},
       .singular = {{{0, 1, 2}}, {{1, 1, 2}}},
       .ulp_bound = 0},
      {.kind = OpKind::Convert,
       .shape = Shape::Elementwise,
       .doc =
           "Another element type. Float to integer truncates and saturates, NaN gives 0 and false; integers wrap. No "
           "derivative but from Float to Float.",
       .cost = 0,
       .light = true,
       .recompute = Recompute::Always,
       .folds = Folds::Rounds,
       .infer = infer_convert,
       .eval = eval_convert,
       .glsl = convert_glsl,
       .prelude_of = convert_prelude,
       .adjoint = [](const AdjointInput& in) -> AdjointOutput {
         const bool flows =
             in.builder.value(in.operands[0]).type.is_float() && in.builder.value(in.result).type.is_float();
         return {flows ? in.adjoint : kNoAdjoint};
       },
       .domains = {{-10, 10}},
       .singular = {{{0}}, {{1}}},
       .ulp_bound = 0.5},
  };
}

}  // namespace dr::ops
