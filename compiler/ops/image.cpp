// SPDX-License-Identifier: Apache-2.0
// Ops that read elements at other places or change the extent. What they do is the evaluator's and the backend's to
// implement; here are their types and adjoints. Out of range reads 0, a write there is dropped.
#include "compiler/ops/families.h"
#include "compiler/ops/rules.h"

namespace dr::ops {

using namespace rules;

namespace {

// An index names a place of an image: int (x), ivec2 (x, y), both in the current layer, or ivec3 (x, y, layer).
std::string expect_index(const ResultType& index, const Extent& image) {
  const Type type = index.type;
  if (type.scalar != Scalar::Int || type.is_matrix() || type.rows > 3)
    return "an index is int, ivec2 or ivec3, not " + type.str();
  if (type.rows == 1 && !image.h.is_one()) return "an int does not name a place of an image of height " + image.h.str();
  return "";
}

InferResult infer_gather(const InferInput& in) {
  if (std::string wrong = expect_operands(in, 2); !wrong.empty()) return wrong;
  const ResultType& image = in.operands[0];
  const ResultType& index = in.operands[1];
  if (std::string wrong = expect_index(index, image.extent); !wrong.empty()) return wrong;
  if (index.type.rows == 3) return one(image.type, index.extent);
  const auto layers = ir::broadcast({1, 1, index.extent.l}, {1, 1, image.extent.l});
  if (!layers) return "layers do not agree: " + image.extent.str() + " and " + index.extent.str();
  return one(image.type, {index.extent.w, index.extent.h, layers->l});
}

InferResult infer_scatter(const InferInput& in, Accepts what) {
  if (std::string wrong = expect_operands(in, 2); !wrong.empty()) return wrong;
  if (std::string wrong = expect_dims(in.attrs, 3); !wrong.empty()) return wrong;
  const Extent image = extent_of(in.attrs);
  if (std::string wrong = expect_index(in.operands[0], image); !wrong.empty()) return wrong;
  if (std::string wrong = expect_accepted(in.operands.subspan(1), what); !wrong.empty()) return wrong;
  auto extent = common_extent(in.operands);
  if (auto* wrong = std::get_if<std::string>(&extent)) return std::move(*wrong);
  const Dim& layers = std::get<Extent>(extent).l;
  if (in.operands[0].type.rows < 3 && !image.l.is_one() && image.l != layers) {
    return "elements of " + layers.str() + " layers do not each have one of " + image.l.str();
  }
  return one(in.operands[1].type, image);
}

InferResult infer_scatter_add(const InferInput& in) { return infer_scatter(in, kNumbers); }

InferResult infer_scatter_max(const InferInput& in) {
  if (in.operands.size() == 2 && in.operands[1].type.scalar != Scalar::Int)
    return "takes int, not " + in.operands[1].type.str();
  return infer_scatter(in, kInts);
}

InferResult infer_shift(const InferInput& in) {
  if (std::string wrong = expect_operands(in, 1); !wrong.empty()) return wrong;
  if (std::string wrong = expect_ints(in.attrs, 2); !wrong.empty()) return wrong;
  return one(in.operands[0].type, in.operands[0].extent);
}

InferResult infer_reduce(const InferInput& in) {
  if (std::string wrong = expect_operands(in, 1); !wrong.empty()) return wrong;
  if (std::string wrong = expect_ints(in.attrs, 3); !wrong.empty()) return wrong;
  if (std::string wrong = expect_accepted(in.operands, kNumbers); !wrong.empty()) return wrong;
  Extent extent = in.operands[0].extent;
  Dim* axes[] = {&extent.w, &extent.h, &extent.l};
  for (size_t axis = 0; axis < 3; ++axis) {
    if (in.attrs.ints[axis] != 0 && in.attrs.ints[axis] != 1) return "an axis is taken away or not, 1 or 0";
    if (in.attrs.ints[axis] == 1) *axes[axis] = Dim(1);
  }
  return one(in.operands[0].type, extent);
}

InferResult infer_broadcast(const InferInput& in) {
  if (std::string wrong = expect_operands(in, 1); !wrong.empty()) return wrong;
  if (std::string wrong = expect_dims(in.attrs, 3); !wrong.empty()) return wrong;
  const Extent extent = extent_of(in.attrs);
  if (!stretches_to(in.operands[0].extent, extent)) {
    return "extent " + in.operands[0].extent.str() + " does not stretch to " + extent.str();
  }
  return one(in.operands[0].type, extent);
}

Attrs dims_of(const Extent& extent) {
  Attrs attrs;
  attrs.dims = {extent.w, extent.h, extent.l};
  return attrs;
}

// Each element's adjoint goes to the place that it was read from.
AdjointOutput gather_adjoint(const AdjointInput& in) {
  Builder& b = in.builder;
  const Type type = b.value(in.operands[0]).type;
  const Attrs dims = dims_of(b.value(in.operands[0]).extent);
  const ValueId index = in.operands[1];
  if (!type.is_matrix()) return {emit(b, OpKind::ScatterAdd, {index, in.adjoint}, dims), kNoAdjoint};
  std::vector<ValueId> columns;
  for (int k = 0; k < type.cols; ++k)
    columns.push_back(emit(b, OpKind::ScatterAdd, {index, extract(b, in.adjoint, k)}, dims));
  return {compose(b, columns, type), kNoAdjoint};
}

// Each value's adjoint is read from the place that it went to. Value and index stretch to each other, so a value that
// went to several places has the sum.
AdjointOutput scatter_add_adjoint(const AdjointInput& in) {
  Builder& b = in.builder;
  const ValueId read = emit(b, OpKind::Gather, {in.adjoint, in.operands[0]});
  const Extent extent = b.value(in.operands[1]).extent;
  return {kNoAdjoint, broadcast(b, reduce_to(b, read, extent), extent)};
}

// Elements that equal their result share its adjoint.
AdjointOutput reduce_extreme_adjoint(const AdjointInput& in) {
  Builder& b = in.builder;
  const ValueId x = in.operands[0];
  const ValueId equal = apply(b, OpKind::Equal, x, in.result);
  const ValueId zero = zero_like(b, x);
  const ValueId winners = select(b, equal, like(b, x, 1.0), zero);
  const ValueId count = emit(b, OpKind::ReduceSum, {winners}, in.attrs);
  return {keep_where(b, equal, smul(b, in.adjoint, safe_reciprocal(b, count)))};
}

}  // namespace

std::vector<OpInfo> image_ops() {
  return {
      {.kind = OpKind::Gather,
       .shape = Shape::Image,
       .doc = "The elements of x at computed places; 0 out of range.",
       .light = true,
       .reads = Reads::FirstElsewhere,
       .runs_as = RunsAs::Map,
       .no_gradient = "the index of a read is an integer and has no derivative",
       .infer = infer_gather,
       .adjoint = gather_adjoint},
      {.kind = OpKind::ScatterAdd,
       .shape = Shape::Image,
       .doc = "An image whose elements are the sums of the values that name them; names out of range are dropped.",
       .reads = Reads::AtElement,
       .runs_as = RunsAs::Scatter,
       .infer = infer_scatter_add,
       .adjoint = scatter_add_adjoint},
      {.kind = OpKind::ScatterMax,
       .shape = Shape::Image,
       .doc =
           "An image whose elements are the largest of the values that name them, and 0 where none does. Int only; the "
           "least one counts as nothing.",
       .reads = Reads::AtElement,
       .runs_as = RunsAs::Scatter,
       .infer = infer_scatter_max,
       .differentiable = false},
      {.kind = OpKind::Shift,
       .shape = Shape::Image,
       .doc = "The neighbour at a constant distance in the same layer; 0 outside.",
       .reads = Reads::Elsewhere,
       .runs_as = RunsAs::Map,
       .infer = infer_shift,
       .adjoint = [](const AdjointInput& in) -> AdjointOutput {
         Attrs back;
         back.ints = {-in.attrs.ints[0], -in.attrs.ints[1]};
         return {emit(in.builder, OpKind::Shift, {in.adjoint}, std::move(back))};
       }},
      {.kind = OpKind::ReduceSum,
       .shape = Shape::Image,
       .doc = "The sum along the axes taken away.",
       .reads = Reads::Elsewhere,
       .runs_as = RunsAs::Reduce,
       .infer = infer_reduce,
       .adjoint = [](const AdjointInput& in) -> AdjointOutput {
         return {broadcast(in.builder, in.adjoint, in.builder.value(in.operands[0]).extent)};
       }},
      {.kind = OpKind::ReduceMin,
       .shape = Shape::Image,
       .doc =
           "The minimum along the axes taken away; a NaN loses. Elements that share it share its derivative equally.",
       .reads = Reads::Elsewhere,
       .runs_as = RunsAs::Reduce,
       .infer = infer_reduce,
       .adjoint = reduce_extreme_adjoint},
      {.kind = OpKind::ReduceMax,
       .shape = Shape::Image,
       .doc =
           "The maximum along the axes taken away; a NaN loses. Elements that share it share its derivative equally.",
       .reads = Reads::Elsewhere,
       .runs_as = RunsAs::Reduce,
       .infer = infer_reduce,
       .adjoint = reduce_extreme_adjoint},
      {.kind = OpKind::Broadcast,
       .shape = Shape::Image,
       .doc = "x stretched along axes of extent 1.",
       .cost = 0,
       .moves = true,
       .light = true,
       .recompute = Recompute::Always,
       .zero = ZeroWhere::FirstIs,
       .reads = Reads::AtElement,
       .runs_as = RunsAs::Map,
       .infer = infer_broadcast,
       .adjoint = [](const AdjointInput& in) -> AdjointOutput {
         return {reduce_to(in.builder, in.adjoint, in.builder.value(in.operands[0]).extent)};
       }},
  };
}

}  // namespace dr::ops
