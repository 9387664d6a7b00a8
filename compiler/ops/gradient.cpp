// SPDX-License-Identifier: Apache-2.0
// Gradients, and the marks that passes respect: Detach stops gradients, Pin asks for storage.
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
      {.kind = OpKind::Detach,
       .shape = Shape::Elementwise,
       .doc = "x without gradient.",
       .infer = component_wise<1, kAnything>,
       .eval = copy,
       .glsl = same,
       .differentiable = false,
       .domains = {{-3, 3}},
       .ulp_bound = 0},
      {.kind = OpKind::Pin,
       .shape = Shape::Elementwise,
       .doc = "x, stored wherever it crosses shaders.",
       .infer = component_wise<1, kAnything>,
       .eval = copy,
       .glsl = same,
       .adjoint = [](const AdjointInput& in) -> AdjointOutput { return {in.adjoint}; },
       .domains = {{-3, 3}},
       .ulp_bound = 0},
  };
}

}  // namespace dr::ops
