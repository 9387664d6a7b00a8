// SPDX-License-Identifier: Apache-2.0
// The adjoints of the ops that move elements: what is read from several places, lands in several, or is shared on ties.
#include <functional>
#include <map>

#include "compiler/ops/op.h"
#include "tests/catch.h"
#include "tests/gradient/check.h"

using namespace dr::gradient_test;
using dr::ir::kFloat;
using dr::ir::kInt;
using dr::ir::Scalar;
using dr::ir::vec;
namespace ops = dr::ops;

namespace {

const Extent kRow{5, 1, 1};
const Extent kGrid{4, 3, 1};
const Extent kStack{4, 3, 2};
const Type kVec3 = vec(3);
const Type kMat2x3{Scalar::Float, 3, 2};

ValueId index(Problem& p, const std::string& name, int size, const Extent& extent, int from, int count) {
  std::vector<double> data;
  const int64_t elements = extent.w.constant() * extent.h.constant() * extent.l.constant();
  for (int64_t k = 0; k < size * elements; ++k) data.push_back(from + p.random.integer(count));
  return p.input(name, vec(size, Scalar::Int), extent, data);
}

ValueId squared(Builder& b, ValueId x) { return ops::mul(b, x, x); }
// Gradients of matrices are checked through their columns.
ValueId columns(Builder& b, ValueId x) {
  return squared(b, ops::add(b, ops::extract(b, x, 0), squared(b, ops::extract(b, x, 1))));
}
Images gradient(const Problem& problem, const std::vector<std::pair<std::string, ValueId>>& outputs) {
  Graph graph = problem.b.graph();
  add_step(graph, "look", outputs);
  const Graph done = differentiated(graph);
  dr::reference::Session session(done);
  bind_leaves(session, problem.data);
  return run(session, "look");
}

}  // namespace

TEST_CASE("gather adds up at the places it reads, and not outside") {
  Problem p;
  const ValueId row = p.param("row", kVec3, kRow);
  const ValueId grid = p.param("grid", kFloat, kGrid);
  const ValueId stack = p.param("stack", kFloat, kStack);
  Builder& b = p.b;
  SECTION("int") {
    check_gradients(p, squared(b, ops::emit(b, OpKind::Gather, {row, index(p, "i", 1, kGrid, -1, 7)})));
  }
  SECTION("ivec2, one layer read by several") {
    check_gradients(p, squared(b, ops::emit(b, OpKind::Gather, {grid, index(p, "i", 2, {3, 3, 2}, -1, 6)})));
  }
  SECTION("ivec2, each in its layer") {
    check_gradients(p, squared(b, ops::emit(b, OpKind::Gather, {stack, index(p, "i", 2, {3, 3, 2}, -1, 6)})));
  }
  SECTION("ivec2, one place in all layers") {
    check_gradients(p, squared(b, ops::emit(b, OpKind::Gather, {stack, index(p, "i", 2, {3, 3, 1}, -1, 6)})));
  }
  SECTION("ivec3") {
    check_gradients(p, squared(b, ops::emit(b, OpKind::Gather, {stack, index(p, "i", 3, kRow, -1, 5)})));
  }
}

TEST_CASE("gather of matrices") {
  Problem p;
  const ValueId parts = p.param("parts", kVec3, kRow);
  Builder& b = p.b;
  const ValueId matrices = ops::compose(b, {parts, squared(b, parts)}, kMat2x3);
  check_gradients(p, columns(b, ops::emit(b, OpKind::Gather, {matrices, index(p, "i", 1, kGrid, -1, 7)})));
}

TEST_CASE("a matrix that stretches over an image") {
  Problem p;
  const ValueId part = p.param("part", kVec3, {});
  const ValueId image = p.param("image", kVec3, kGrid);
  Builder& b = p.b;
  const ValueId one = ops::compose(b, {part, squared(b, part)}, kMat2x3);
  const ValueId many = ops::compose(b, {image, squared(b, image)}, kMat2x3);
  SECTION("sum") { check_gradients(p, columns(b, ops::add(b, one, many))); }
  SECTION("broadcast") {
    check_gradients(p, columns(b, ops::sub(b, ops::broadcast(b, one, kGrid), ops::neg(b, many))));
  }
}

TEST_CASE("scatter reads back from where it went") {
  Problem p;
  Builder& b = p.b;
  SECTION("one index a value") {
    const ValueId v = p.param("v", kVec3, kGrid);
    check_gradients(p, squared(b, ops::emit(b, OpKind::ScatterAdd, {index(p, "i", 1, kGrid, -1, 7), v}, dims(kRow))));
  }
  SECTION("one value at many places, in an image of one element") {
    const ValueId v = p.param("v", kFloat, {});
    check_gradients(p,
                    squared(b, ops::emit(b, OpKind::ScatterAdd, {index(p, "i", 1, kRow, -1, 3), v}, dims({1, 1, 1}))));
  }
  SECTION("many values at one place") {
    const ValueId v = p.param("v", kFloat, kRow);
    check_gradients(p, squared(b, ops::emit(b, OpKind::ScatterAdd, {index(p, "i", 2, {}, 0, 3), v}, dims(kGrid))));
  }
  SECTION("layers, each its own") {
    const ValueId v = p.param("v", kFloat, kStack);
    check_gradients(
        p, squared(b, ops::emit(b, OpKind::ScatterAdd, {index(p, "i", 2, {4, 3, 1}, -1, 5), v}, dims({3, 3, 2}))));
  }
  SECTION("layers, all into one") {
    const ValueId v = p.param("v", kFloat, kStack);
    check_gradients(
        p, squared(b, ops::emit(b, OpKind::ScatterAdd, {index(p, "i", 2, kStack, -1, 5), v}, dims({3, 3, 1}))));
  }
  SECTION("layers by name") {
    const ValueId v = p.param("v", kVec3, kRow);
    check_gradients(p, squared(b, ops::emit(b, OpKind::ScatterAdd, {index(p, "i", 3, kRow, -1, 4), v}, dims(kStack))));
  }
}

TEST_CASE("shift, sums and broadcasts") {
  Problem p;
  const ValueId x = p.param("x", kVec3, kStack);
  Builder& b = p.b;
  SECTION("shift") { check_gradients(p, squared(b, ops::emit(b, OpKind::Shift, {x}, ints({1, -2})))); }
  SECTION("far shift") { check_gradients(p, squared(b, ops::emit(b, OpKind::Shift, {x}, ints({-9, 0})))); }
  SECTION("sum over one axis") {
    check_gradients(p, squared(b, ops::emit(b, OpKind::ReduceSum, {x}, ints({0, 1, 0}))));
  }
  SECTION("sum over all") { check_gradients(p, squared(b, ops::emit(b, OpKind::ReduceSum, {x}, ints({1, 1, 1})))); }
  SECTION("broadcast") {
    const ValueId low = ops::emit(b, OpKind::ReduceSum, {x}, ints({0, 1, 1}));
    check_gradients(p, ops::mul(b, x, squared(b, ops::broadcast(b, low, kStack))));
  }
}

TEST_CASE("minimum and maximum of images") {
  Problem p;
  const ValueId x = p.param("x", kVec3, kStack);
  // No two elements closer than the differences reach.
  std::vector<double>& data = p.data.at("x").data;
  for (size_t k = 0; k < data.size(); ++k) data[k] = 0.1 * static_cast<double>(k * 29 % 72) + 0.02 * data[k] - 3.55;
  Builder& b = p.b;
  for (const OpKind kind : {OpKind::ReduceMin, OpKind::ReduceMax}) {
    check_gradients(p, squared(b, ops::emit(b, kind, {x}, ints({1, 0, 1}))));
    check_gradients(p,
                    squared(b, ops::emit(b, kind, {ops::mul(b, x, ops::constant(b, kVec3, -2.0))}, ints({1, 1, 1}))));
  }
}

TEST_CASE("ties share, a NaN has nothing") {
  Problem p;
  Builder& b = p.b;
  const ValueId x = p.param("x", kFloat, kRow);
  p.data.at("x").data = {1, 3, 1, std::nan(""), 1};
  const ValueId low = ops::emit(b, OpKind::ReduceMin, {x}, ints({1, 1, 1}));
  const ValueId high = ops::emit(b, OpKind::ReduceMax, {x}, ints({1, 1, 1}));
  const ValueId three = ops::constant(b, kFloat, 3.0);
  const Images g = gradient(p, {{"low", grad(b, low, three, {x})[0]}, {"high", grad(b, high, three, {x})[0]}});
  CHECK(g.at("low").data == std::vector<double>{1, 0, 1, 0, 1});
  CHECK(g.at("high").data == std::vector<double>{0, 3, 0, 0, 0});
}

namespace {

// No two elements closer than the differences reach.
ValueId spread(Problem& p, const std::string& name, Type type, const Extent& extent) {
  const ValueId x = p.param(name, type, extent);
  std::vector<double>& data = p.data.at(name).data;
  for (size_t k = 0; k < data.size(); ++k)
    data[k] =
        0.1 * (static_cast<double>(k * 29 % data.size()) - 0.5 * static_cast<double>(data.size())) + 0.02 * data[k];
  return x;
}

// A value through one op of each kind that is not element-wise.
std::map<OpKind, std::function<ValueId(Problem&)>> subjects() {
  const auto extreme = [](OpKind kind) {
    return [kind](Problem& p) { return ops::emit(p.b, kind, {spread(p, "x", kVec3, kGrid)}, ints({1, 0, 0})); };
  };
  const auto body = [](Problem& p, ValueId x, ValueId i) {
    return ops::mul(p.b, x, ops::emit(p.b, OpKind::Sin, {ops::emit(p.b, OpKind::Gather, {x, i})}));
  };
  return {
      {OpKind::Gather,
       [](Problem& p) {
         return ops::emit(p.b, OpKind::Gather, {p.param("x", kVec3, kRow), index(p, "i", 1, kGrid, -1, 7)});
       }},
      {OpKind::ScatterAdd,
       [](Problem& p) {
         return ops::emit(p.b, OpKind::ScatterAdd, {index(p, "i", 1, kGrid, -1, 7), p.param("x", kVec3, kGrid)},
                          dims(kRow));
       }},
      {OpKind::Shift,
       [](Problem& p) {
         return ops::emit(p.b, OpKind::Shift, {p.param("x", kVec3, kGrid)}, ints({1, -1}));
       }},
      {OpKind::Broadcast,
       [](Problem& p) {
         return ops::broadcast(p.b, p.param("x", kVec3, kRow), {5, 3, 2});
       }},
      {OpKind::ReduceSum,
       [](Problem& p) {
         return ops::emit(p.b, OpKind::ReduceSum, {p.param("x", kVec3, kStack)}, ints({1, 0, 1}));
       }},
      {OpKind::ReduceMin, extreme(OpKind::ReduceMin)},
      {OpKind::ReduceMax, extreme(OpKind::ReduceMax)},
      {OpKind::If,
       [body](Problem& p) {
         const ValueId x = p.param("x", kFloat, kRow);
         const ValueId i = index(p, "i", 1, kRow, -1, 7);
         const ValueId condition = ops::emit(p.b, OpKind::Less, {i, ops::constant(p.b, kInt, 2.0)});
         return make_if(
             p.b, condition, kRow, {Yield::Element}, [&] { return std::vector{body(p, x, i)}; },
             [&] { return std::vector{x}; })[0];
       }},
      {OpKind::Reduce,
       [body](Problem& p) {
         const ValueId x = spread(p, "x", kFloat, kRow);
         const std::vector<ValueId> results =
             make_reduce(p.b, ops::constant(p.b, kInt, 0.0), ops::constant(p.b, kInt, 4.0), kRow,
                         {Yield::Sum, Yield::Min, Yield::Max}, [&](ValueId i) {
                           const ValueId read = ops::emit(p.b, OpKind::Gather, {x, i});
                           return std::vector{body(p, x, i), read, ops::neg(p.b, read)};
                         });
         return ops::add(p.b, results[0], ops::mul(p.b, results[1], results[2]));
       }},
      {OpKind::Fold,
       [body](Problem& p) {
         const ValueId x = spread(p, "x", kFloat, kRow);
         const std::vector<ValueId> results =
             make_fold(p.b, ops::constant(p.b, kInt, 0.0), ops::constant(p.b, kInt, 4.0), kRow, {x, x},
                       [&](ValueId i, const std::vector<ValueId>& states) {
                         const ValueId read = ops::emit(p.b, OpKind::Gather, {x, i});
                         const ValueId next = ops::add(p.b, ops::mul(p.b, states[0], states[1]), body(p, x, i));
                         return Trip{ops::emit(p.b, OpKind::Less, {ops::constant(p.b, kFloat, 9.0), next}),
                                     {next, ops::mul(p.b, states[1], read)}};
                       });
         return ops::add(p.b, results[0], ops::mul(p.b, results[1], results[1]));
       }},
  };
}

}  // namespace

// With the element-wise ones in elementwise_test.cpp these are all ops through which a gradient flows.
TEST_CASE("every differentiable op that is not element-wise is checked") {
  const auto known = subjects();
  size_t checked = 0;
  for (const OpKind kind : dr::ir::all_op_kinds()) {
    const ops::OpInfo& info = ops::info(kind);
    if ((info.shape != ops::Shape::Image && info.shape != ops::Shape::Region) || !info.differentiable) continue;
    INFO(dr::ir::op_name(kind));
    REQUIRE(known.contains(kind));
    ++checked;
    Problem p;
    const ValueId y = known.at(kind)(p);
    check_gradients(p, squared(p.b, y));
  }
  CHECK(checked == known.size());
}
