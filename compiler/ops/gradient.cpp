// SPDX-License-Identifier: Apache-2.0
// Gradients, and the marks that passes respect: Detach stops gradients, Pin asks for storage, Unlikely parts branches.
#include "compiler/ops/families.h"
#include "compiler/ops/rules.h"

namespace dr::ops {

using namespace rules;

namespace {

InferResult infer_grad(const InferInput& in) {
  if (in.operands.size() < 3) return "a gradient has a value, a seed and at least one target";
  const ResultType& value = in.operands[0];
  const ResultType& seed = in.operands[1];
  if (!value.type.is_float()) return "a " + value.type.str() + " has no gradient";
  if (seed.type != value.type || !stretches_to(seed.extent, value.extent)) {
    return "the seed of " + words(value) + " cannot be " + words(seed);
  }
  std::vector<ResultType> results;
  for (const ResultType& target : in.operands.subspan(2))
    results.push_back({.type = target.type, .extent = target.extent});
  return results;
}

InferResult infer_vjp(const InferInput& in) {
  const size_t count = in.operands.size();
  if (count < 4 || count % 2 != 0) return "a vjp has a value, its cotangent, and as many targets as adjoints";
  const ResultType& value = in.operands[0];
  const ResultType& cotangent = in.operands[1];
  if (!value.type.is_float()) return "a " + value.type.str() + " has no gradient";
  if (cotangent.type != value.type || !ir::broadcast(cotangent.extent, value.extent)) {
    return "the cotangent of " + words(value) + " cannot be " + words(cotangent);
  }
  const size_t targets = (count - 2) / 2;
  for (size_t k = 0; k < targets; ++k) {
    const ResultType& target = in.operands[2 + k];
    const ResultType& adjoint = in.operands[2 + targets + k];
    if (!target.type.is_float() || adjoint.type != target.type) {
      return "the adjoint of " + words(target) + " cannot be " + words(adjoint);
    }
  }
  return std::vector<ResultType>{{.type = value.type, .extent = value.extent}};
}

InferResult infer_cotangent(const InferInput& in) {
  if (std::string wrong = expect_operands(in, 0); !wrong.empty()) return wrong;
  if (std::string wrong = expect_ints(in.attrs, 3); !wrong.empty()) return wrong;
  if (std::string wrong = expect_dims(in.attrs, 3); !wrong.empty()) return wrong;
  const int64_t rows = in.attrs.ints[0], cols = in.attrs.ints[1];
  if (rows < 1 || rows > 4 || cols < 1 || cols > 4) return "a cotangent has 1 to 4 rows and columns";
  return one({Scalar::Float, static_cast<uint8_t>(rows), static_cast<uint8_t>(cols)}, extent_of(in.attrs));
}

void copy(const EvalBatch& e) {
  map1(e, [](double x) { return x; });
}
std::string same(const GlslInput& in) { return in.operands[0]; }

}  // namespace

std::vector<OpInfo> gradient_ops() {
  return {
      {.kind = OpKind::Grad,
       .shape = Shape::Gradient,
       .doc = "The adjoint of each target from the seed, that of the value; zeros where nothing flows.",
       .infer = infer_grad},
      {.kind = OpKind::Vjp,
       .shape = Shape::Gradient,
       .doc = "y; a gradient reaches the targets as the given adjoints, and y's own operands not at all.",
       .infer = infer_vjp},
      {.kind = OpKind::Cotangent,
       .shape = Shape::Gradient,
       .doc = "Stands for the adjoint of a vjp's result in the adjoints of its targets.",
       .infer = infer_cotangent,
       .differentiable = false},
      {.kind = OpKind::Detach,
       .shape = Shape::Elementwise,
       .doc = "x without gradient.",
       .folds = Folds::Never,
       .zero = ZeroWhere::FirstIs,
       .no_gradient = "$ lets no gradient through",
       .infer = component_wise<1, kAnything>,
       .eval = copy,
       .glsl = same,
       .differentiable = false,
       .domains = {{-3, 3}},
       .ulp_bound = 0},
      {.kind = OpKind::Pin,
       .shape = Shape::Elementwise,
       .doc = "x, stored wherever it crosses shaders.",
       .folds = Folds::Never,
       .zero = ZeroWhere::FirstIs,
       .infer = component_wise<1, kAnything>,
       .eval = copy,
       .glsl = same,
       .adjoint = [](const AdjointInput& in) -> AdjointOutput { return {in.adjoint}; },
       .domains = {{-3, 3}},
       .ulp_bound = 0},
      {.kind = OpKind::Unlikely,
       .shape = Shape::Elementwise,
       .doc = "x, which the program says seldom holds: branches that it decides may run apart from the rest.",
       .zero = ZeroWhere::FirstIs,
       .infer = component_wise<1, kBools>,
       .eval = copy,
       .glsl = same,
       .differentiable = false,
       .ulp_bound = 0},
  };
}

}  // namespace dr::ops
