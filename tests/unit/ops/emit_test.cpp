// SPDX-License-Identifier: Apache-2.0
// The helpers that write ops: what they make and what they leave as it is.
#include "compiler/ops/emit.h"

#include "tests/catch.h"

using namespace dr;
using ir::Builder;
using ir::Extent;
using ir::OpKind;
using ir::Scalar;
using ir::Type;
using ir::ValueId;
using ir::vec;

namespace {

struct Fixture {
  Builder b;
  ValueId image(Type type, const Extent& extent) { return ops::broadcast(b, ops::constant(b, type, 1.0), extent); }
  std::string text(ValueId id) { return b.value(id).type.str() + b.value(id).extent.str(); }
  OpKind kind(ValueId id) { return b.graph().op(b.value(id).op).kind; }
};

}  // namespace

TEST_CASE_METHOD(Fixture, "constants have the type they are given") {
  CHECK(text(ops::constant(b, vec(2, Scalar::Uint), {1, 2})) == "uvec2");
  const ValueId every = ops::constant(b, Type{Scalar::Float, 3, 2}, 0.5);
  CHECK(b.graph().op(b.value(every).op).attrs.floats == std::vector<double>(6, 0.5));
  CHECK(text(ops::zero_like(b, image(vec(3), {4, 4, 1}))) == "vec3");
}

TEST_CASE_METHOD(Fixture, "what changes nothing makes no op") {
  const ValueId x = image(ir::kFloat, {3, 1, 1});
  CHECK(ops::splat(b, x, 1) == x);
  CHECK(ops::extract(b, x, 0) == x);
  CHECK(ops::compose(b, {x}, ir::kFloat) == x);
  CHECK(ops::broadcast(b, x, {3, 1, 1}) == x);
  CHECK(ops::reduce_to(b, x, {3, 1, 1}) == x);
  CHECK(ops::reduce_to(b, x, {3, 4, 1}) == x);
}

TEST_CASE_METHOD(Fixture, "scalars splat beside a vector in smul") {
  const ValueId g = image(vec(3), {3, 1, 1});
  const ValueId x = image(ir::kFloat, {1, 2, 1});
  CHECK(text(ops::smul(b, g, x)) == "vec3[3, 2]");
  CHECK(text(ops::smul(b, x, g)) == "vec3[3, 2]");
  CHECK(text(ops::smul(b, x, x)) == "float[1, 2]");
}

TEST_CASE_METHOD(Fixture, "reduce_to sums exactly the stretched axes") {
  const ValueId x = image(vec(2), {3, 2, 5});
  const ValueId sum = ops::reduce_to(b, x, {1, 2, 1});
  CHECK(text(sum) == "vec2[1, 2]");
  CHECK(b.graph().op(b.value(sum).op).attrs.ints == std::vector<int64_t>{1, 0, 1});
  const ValueId matrix = image(Type{Scalar::Float, 3, 2}, {3, 1, 1});
  const ValueId columns = ops::reduce_to(b, matrix, {});
  CHECK(text(columns) == "mat2x3");
  CHECK(kind(columns) == OpKind::Compose);
}

TEST_CASE_METHOD(Fixture, "sources") {
  CHECK(text(ops::coord(b, 1, {4, 3, 1})) == "int[4, 3]");
  CHECK(text(ops::dim_value(b, ir::Dim::symbol("W"))) == "int");
}
