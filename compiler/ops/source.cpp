// SPDX-License-Identifier: Apache-2.0
// Sources: values that come from no other value. The evaluator and the printer make them; here are their types.
#include "compiler/ops/families.h"
#include "compiler/ops/rules.h"

namespace dr::ops {

using namespace rules;

namespace {

InferResult infer_leaf(const GraphInferInput& in) {
  if (!in.operands.empty() || !in.regions.empty()) return "a leaf has no operands";
  const auto index = in.graph.leaf_index(in.attrs.text);
  if (!index) return "there is no leaf '" + in.attrs.text + "'";
  return one(in.graph.leaves[*index].type, in.graph.leaves[*index].extent);
}

InferResult infer_const(const GraphInferInput& in) {
  if (!in.operands.empty() || !in.regions.empty()) return "a constant has no operands";
  if (!in.written) return "a constant's type is written on it alone";
  const size_t count = in.attrs.floats.size();
  if (count != static_cast<size_t>(in.written->components())) {
    return "a " + in.written->str() + " does not have " + std::to_string(count) + " components";
  }
  for (const double x : in.attrs.floats) {
    const bool fits = in.written->is_float()  ? true
                      : in.written->is_bool() ? x == 0 || x == 1
                      : in.written->scalar == Scalar::Int
                          ? x >= -2147483648.0 && x <= 2147483647.0 && x == std::floor(x)
                          : x >= 0 && x <= 4294967295.0 && x == std::floor(x);
    if (!fits) return "a component is no " + in.written->element().str();
  }
  return one(*in.written, {});
}

InferResult infer_coord(const InferInput& in) {
  if (std::string wrong = expect_operands(in, 0); !wrong.empty()) return wrong;
  if (std::string wrong = expect_ints(in.attrs, 1); !wrong.empty()) return wrong;
  if (std::string wrong = expect_dims(in.attrs, 3); !wrong.empty()) return wrong;
  if (in.attrs.ints[0] < 0 || in.attrs.ints[0] > 2) return "there are three axes, 0 to 2";
  return one(ir::kInt, extent_of(in.attrs));
}

InferResult infer_dim(const InferInput& in) {
  if (std::string wrong = expect_operands(in, 0); !wrong.empty()) return wrong;
  if (std::string wrong = expect_dims(in.attrs, 1); !wrong.empty()) return wrong;
  return one(ir::kInt, {});
}

InferResult infer_step_index(const InferInput& in) {
  if (std::string wrong = expect_operands(in, 0); !wrong.empty()) return wrong;
  return one(ir::kInt, {});
}

}  // namespace

std::vector<OpInfo> source_ops() {
  return {
      {.kind = OpKind::Leaf,
       .shape = Shape::Source,
       .doc = "What a leaf held when the step began.",
       .infer_in_graph = infer_leaf,
       .differentiable = false},
      {.kind = OpKind::Const,
       .shape = Shape::Source,
       .doc = "A constant; on devices the nearest float32.",
       .cost = 0,
       .zero = ZeroWhere::ItsValueIs,
       .infer_in_graph = infer_const,
       .differentiable = false},
      {.kind = OpKind::Coord,
       .shape = Shape::Source,
       .doc = "Each element's own place on one axis.",
       .cost = 0,
       .infer = infer_coord,
       .differentiable = false},
      {.kind = OpKind::DimValue,
       .shape = Shape::Source,
       .doc = "The value of an extent expression.",
       .cost = 0,
       .infer = infer_dim,
       .differentiable = false},
      {.kind = OpKind::StepIndex,
       .shape = Shape::Source,
       .doc = "How often the running step has completed before.",
       .infer = infer_step_index,
       .differentiable = false},
  };
}

}  // namespace dr::ops
