// SPDX-License-Identifier: Apache-2.0
// The pass `differentiate` on small graphs: what a target is, how adjoints add up, every way in which values move
// between elements, and the structured constructs, each with its second derivatives.
#include <cmath>
#include <limits>

#include "tests/catch.h"
#include "tests/gradient/check.h"

using namespace dr::gradient_test;
using dr::ir::kFloat;
using dr::ir::kInt;
using dr::ir::Scalar;
using dr::ir::vec;
namespace ops = dr::ops;

namespace {

const Extent kOne{};
const Extent kRow{5, 1, 1};
const Extent kGrid{4, 3, 1};
const Extent kLayers{1, 1, 2};
const Extent kStack{4, 3, 2};
const dr::ir::Type kVec3 = vec(3);
const dr::ir::Type kIvec2 = vec(2, Scalar::Int);

ValueId number(Builder& b, double x) { return ops::constant(b, kFloat, x); }
ValueId integer(Builder& b, double x) { return ops::constant(b, kInt, x); }
ValueId op(Builder& b, OpKind kind, std::vector<ValueId> operands) { return ops::emit(b, kind, std::move(operands)); }
ValueId sin(Builder& b, ValueId x) { return op(b, OpKind::Sin, {x}); }
ValueId exp(Builder& b, ValueId x) { return op(b, OpKind::Exp, {x}); }
ValueId gather(Builder& b, ValueId x, ValueId i) { return op(b, OpKind::Gather, {x, i}); }
ValueId less(Builder& b, ValueId x, ValueId y) { return op(b, OpKind::Less, {x, y}); }
ValueId to_float(Builder& b, ValueId i) {
  return ops::emit(b, OpKind::Convert, {i}, ints({static_cast<int64_t>(Scalar::Float)}));
}
ValueId position(Builder& b, const Extent& extent) {
  return ops::compose(b, {ops::coord(b, 0, extent), ops::coord(b, 1, extent)}, kIvec2);
}

// The outputs of the only step after differentiation.
Images results(const Problem& problem, const std::vector<std::pair<std::string, ValueId>>& outputs) {
  Graph graph = problem.b.graph();
  add_step(graph, "look", outputs);
  const Graph done = differentiated(graph);
  dr::reference::Session session(done);
  bind_leaves(session, problem.data);
  return run(session, "look");
}

}  // namespace

// --- targets and seeds ---

TEST_CASE("equal values are different targets") {
  Problem p;
  const ValueId x = p.param("x", kFloat, kOne);
  const ValueId a = ops::mul(p.b, number(p.b, 2), x);
  const ValueId c = ops::mul(p.b, number(p.b, 2), x);
  const std::vector<ValueId> g = grad(p.b, ops::add(p.b, a, c), number(p.b, 1), {a, x});
  const Images r = results(p, {{"a", g[0]}, {"x", g[1]}});
  CHECK(r.at("a").data[0] == 1);
  CHECK(r.at("x").data[0] == 4);
}

TEST_CASE("gradients go through a target to what lies behind it") {
  Problem p;
  const ValueId x = p.param("x", kFloat, kOne);
  const ValueId t = ops::mul(p.b, x, x);
  const ValueId y = ops::mul(p.b, t, ops::mul(p.b, t, x));  // x^5
  const std::vector<ValueId> g = grad(p.b, y, number(p.b, 1), {x, t, y});
  const Images r = results(p, {{"x", g[0]}, {"t", g[1]}, {"y", g[2]}});
  const double v = p.data.at("x").data[0];
  CHECK(r.at("x").data[0] == Approx(5 * std::pow(v, 4)));
  CHECK(r.at("t").data[0] == Approx(2 * std::pow(v, 3)));
  CHECK(r.at("y").data[0] == 1);
}

TEST_CASE("a target without a path gets zeros of its own extent") {
  Problem p;
  const ValueId x = p.param("x", kVec3, kGrid);
  const ValueId other = p.param("other", kVec3, kGrid);
  const ValueId index = ops::coord(p.b, 0, kGrid);
  const ValueId fixed = op(p.b, OpKind::Detach, {ops::mul(p.b, ops::splat(p.b, to_float(p.b, index), 3), x)});
  const std::vector<ValueId> g = grad(p.b, ops::mul(p.b, fixed, other), ops::constant(p.b, kVec3, 1.0), {x, index});
  const Images r = results(p, {{"x", g[0]}, {"index", g[1]}});
  CHECK(r.at("x").count() == 12);
  CHECK(r.at("x").data == std::vector<double>(36, 0.0));
  CHECK(r.at("index").type == kInt);
  CHECK(r.at("index").data == std::vector<double>(12, 0.0));
}

TEST_CASE("a target may be where the road ends") {
  Problem p;
  Builder& b = p.b;
  const ValueId x = p.param("x", kFloat, kGrid);
  const ValueId fixed = op(b, OpKind::Detach, {x});
  const ValueId chosen = make_if(
      b, less(b, x, number(b, 0)), kGrid, {Yield::Element}, [&] { return std::vector{number(b, 1)}; },
      [&] { return std::vector{fixed}; })[0];
  const std::vector<ValueId> g = grad(b, ops::mul(b, ops::mul(b, fixed, chosen), x), number(b, 1), {x, chosen});
  const ValueId f = grad(b, ops::mul(b, fixed, x), number(b, 1), {fixed, x})[0];
  const Images r = results(p, {{"x", g[0]}, {"chosen", g[1]}, {"fixed", f}});
  for (size_t k = 0; k < 12; ++k) {
    const double v = p.data.at("x").data[k];
    CHECK(r.at("x").data[k] == Approx(v < 0 ? v : v * v));
    CHECK(r.at("chosen").data[k] == Approx(v * v));
    CHECK(r.at("fixed").data[k] == v);
  }
}

TEST_CASE("a seed of extent one stands for every element") {
  Problem p;
  const ValueId x = p.param("x", kFloat, kOne);
  const ValueId y = p.param("y", kFloat, kGrid);
  const std::vector<ValueId> g = grad(p.b, ops::add(p.b, x, y), number(p.b, 3), {x, y});
  const Images r = results(p, {{"x", g[0]}, {"y", g[1]}});
  CHECK(r.at("x").data == std::vector<double>{36});
  CHECK(r.at("y").data == std::vector<double>(12, 3.0));
}

TEST_CASE("a seed of extent one has its elements where elements move") {
  Problem p;
  const ValueId x = p.param("x", kFloat, {4, 1, 1});
  const ValueId index = p.input("index", kInt, {3, 1, 1}, {2, 2, 7});
  const ValueId seed = number(p.b, 1);
  const ValueId shifted = grad(p.b, ops::emit(p.b, OpKind::Shift, {x}, ints({1, 0})), seed, {x})[0];
  const ValueId read = grad(p.b, gather(p.b, x, index), seed, {x})[0];
  const ValueId landed =
      grad(p.b, ops::emit(p.b, OpKind::ScatterAdd, {ops::coord(p.b, 0, {4, 1, 1}), x}, dims({2, 1, 1})), seed, {x})[0];
  const Images r = results(p, {{"shifted", shifted}, {"read", read}, {"landed", landed}});
  CHECK(r.at("shifted").data == std::vector<double>{0, 1, 1, 1});
  CHECK(r.at("read").data == std::vector<double>{0, 0, 2, 0});
  CHECK(r.at("landed").data == std::vector<double>{1, 1, 0, 0});
}

TEST_CASE("a gradient is a target of its own") {
  Problem p;
  const ValueId x = p.param("x", kFloat, kOne);
  const ValueId s = p.param("s", kFloat, kOne);
  // Both results are the seed; only what was named counts.
  const ValueId g = grad(p.b, x, s, {x})[0];
  const ValueId h = grad(p.b, x, s, {x})[0];
  const std::vector<ValueId> d = grad(p.b, ops::add(p.b, ops::add(p.b, g, h), s), number(p.b, 1), {g, s});
  const Images r = results(p, {{"g", d[0]}, {"s", d[1]}});
  CHECK(r.at("g").data[0] == 1);
  CHECK(r.at("s").data[0] == 3);
}

TEST_CASE("results of one gradient do not lead to each other") {
  Problem p;
  const ValueId x = p.param("x", kFloat, kOne);
  const ValueId t = sin(p.b, x);
  const std::vector<ValueId> g = grad(p.b, ops::mul(p.b, t, t), number(p.b, 1), {t, x});
  const std::vector<ValueId> d = grad(p.b, ops::add(p.b, g[0], g[1]), number(p.b, 1), {g[0], g[1]});
  const Images r = results(p, {{"t", d[0]}, {"x", d[1]}});
  CHECK(r.at("t").data[0] == 1);
  CHECK(r.at("x").data[0] == 1);
}

TEST_CASE("the Hessian of a squared product is exact where the product is zero") {
  Problem p;
  const ValueId a = p.param("a", kVec3, kOne);
  const ValueId x = p.input("x", kVec3, kOne, {2, -3, 5});
  p.data.at("a").data = {3, 2, 0};
  const ValueId d = op(p.b, OpKind::Dot, {a, x});
  const ValueId g = grad(p.b, ops::mul(p.b, d, d), number(p.b, 1), {a})[0];
  std::vector<std::pair<std::string, ValueId>> rows;
  for (int k = 0; k < 3; ++k) {
    rows.emplace_back(std::to_string(k), grad(p.b, ops::extract(p.b, g, k), number(p.b, 1), {a})[0]);
  }
  const Images r = results(p, rows);
  const std::vector<double> v{2, -3, 5};
  for (size_t i = 0; i < 3; ++i) {
    for (size_t j = 0; j < 3; ++j) CHECK(r.at(std::to_string(i)).data[j] == 2 * v[i] * v[j]);
  }
}

// --- movement between elements ---

TEST_CASE("broadcasting") {
  Problem p;
  const ValueId x = p.param("x", kFloat, kOne);
  const ValueId row = p.param("row", kFloat, {4, 1, 1});
  const ValueId column = p.param("column", kVec3, {1, 3, 1});
  const ValueId layers = p.param("layers", kFloat, kLayers);
  const ValueId grid = p.param("grid", kFloat, kGrid);
  const ValueId s = ops::mul(p.b, ops::mul(p.b, x, row), ops::add(p.b, layers, grid));
  check_gradients(p, ops::mul(p.b, ops::splat(p.b, sin(p.b, s), 3), column));
  check_gradients(p, ops::mul(p.b, ops::broadcast(p.b, sin(p.b, ops::mul(p.b, x, row)), kStack), layers));
}

TEST_CASE("an adjoint that is the same everywhere counts once an element") {
  Problem p;
  const ValueId x = p.param("x", kFloat, kOne);
  const ValueId row = p.param("row", kFloat, {4, 1, 1});
  const ValueId grid = p.param("grid", kFloat, kGrid);
  check_gradients(p, total(p.b, ops::add(p.b, ops::mul(p.b, x, x), ops::add(p.b, sin(p.b, row), grid))));
}

TEST_CASE("reductions over subsets of the axes") {
  for (const std::vector<int64_t>& axes : {std::vector<int64_t>{1, 1, 1}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {1, 0, 1}}) {
    for (const OpKind kind : {OpKind::ReduceSum, OpKind::ReduceMin, OpKind::ReduceMax}) {
      Problem p(7);
      const ValueId x = p.param("x", kVec3, kStack);
      // Every element its own step of 0.25, so that a difference never changes the winner.
      std::vector<double>& data = p.data.at("x").data;
      for (size_t k = 0; k < data.size(); ++k) data[k] = 0.25 * static_cast<double>(k * 29 % 72) + 0.1 * data[k];
      const ValueId y = p.param("y", kVec3, kOne, 0.9, 1.1);
      check_gradients(
          p, ops::emit(p.b, kind, {sin(p.b, ops::mul(p.b, ops::mul(p.b, ops::constant(p.b, kVec3, 0.05), x), y))},
                       ints(axes)));
    }
  }
}

TEST_CASE("gather and scatter") {
  Problem p;
  const ValueId x = p.param("x", kVec3, kRow);
  const ValueId scale = p.param("scale", kVec3, kOne);
  const ValueId index = p.input("index", kInt, {7, 1, 1}, {0, 3, 3, -1, 4, 9, 1});
  const ValueId y = gather(p.b, ops::mul(p.b, x, x), index);
  check_gradients(p, ops::mul(p.b, y, scale));
  check_gradients(p, ops::emit(p.b, OpKind::ScatterAdd, {index, ops::mul(p.b, sin(p.b, y), scale)}, dims(kRow)));
  // One value that lands in many places.
  check_gradients(
      p, ops::mul(p.b, x, ops::emit(p.b, OpKind::ScatterAdd, {index, ops::mul(p.b, scale, scale)}, dims(kRow))));
}

TEST_CASE("gather and scatter in layers") {
  Problem p;
  const ValueId x = p.param("x", kFloat, kStack);
  const ValueId flat = p.param("flat", kFloat, kGrid);
  const ValueId layers = p.param("layers", kFloat, kLayers);
  const ValueId there = ops::add(p.b, position(p.b, kGrid), ops::constant(p.b, kIvec2, {1, -1}));
  const ValueId own = gather(p.b, ops::mul(p.b, x, x), there);
  const ValueId only = gather(p.b, ops::mul(p.b, flat, flat), there);
  check_gradients(p, ops::mul(p.b, own, ops::mul(p.b, only, layers)));
  check_gradients(p, ops::emit(p.b, OpKind::ScatterAdd, {there, ops::mul(p.b, own, only)}, dims(kStack)));
}

TEST_CASE("shift") {
  Problem p;
  const ValueId x = p.param("x", kVec3, kStack);
  const ValueId y = ops::emit(p.b, OpKind::Shift, {ops::mul(p.b, x, x)}, ints({1, -2}));
  check_gradients(p, ops::mul(p.b, y, x));
  check_gradients(p, total(p.b, y));
}

TEST_CASE("detach and pin") {
  Problem p;
  const ValueId x = p.param("x", kFloat, kRow);
  const ValueId fixed = op(p.b, OpKind::Detach, {exp(p.b, x)});
  const ValueId g = grad(p.b, ops::mul(p.b, fixed, op(p.b, OpKind::Pin, {x})), number(p.b, 1), {x})[0];
  const Images r = results(p, {{"g", g}});
  for (size_t k = 0; k < 5; ++k) CHECK(r.at("g").data[k] == Approx(std::exp(p.data.at("x").data[k])));
}

// --- if ---

TEST_CASE("if with captured values and reads") {
  Problem p;
  Builder& b = p.b;
  const ValueId mask = p.input("mask", kInt, kGrid, {1, 0, 0, 1, 1, 1, 0, 1, 0, 1, 0, 0});
  const ValueId grid = p.param("grid", kFloat, kGrid);
  const ValueId row = p.param("row", kFloat, {4, 1, 1});
  const ValueId one = p.param("one", kVec3, kOne);
  const ValueId table = p.param("table", kVec3, kRow);
  const ValueId picture = p.param("picture", kVec3, kGrid);
  const ValueId condition = op(b, OpKind::Equal, {mask, integer(b, 1)});
  const ValueId column = ops::coord(b, 0, kGrid);
  const ValueId place = position(b, kGrid);

  const auto values = make_if(
      b, condition, kGrid, {Yield::Element, Yield::Element},
      [&] {
        const ValueId read = gather(b, table, ops::add(b, column, integer(b, 2)));
        const ValueId other = gather(b, table, column);
        const ValueId s = ops::mul(b, grid, sin(b, ops::mul(b, row, grid)));
        return std::vector{ops::mul(b, ops::mul(b, read, other), ops::splat(b, s, 3)), s};
      },
      [&] {
        const ValueId read = gather(b, picture, ops::sub(b, place, ops::constant(b, kIvec2, 1.0)));
        const ValueId other = gather(b, table, integer(b, 3));
        return std::vector{ops::mul(b, ops::add(b, ops::mul(b, read, read), other), one), ops::mul(b, grid, grid)};
      });
  check_gradients(p, ops::mul(b, values[0], ops::splat(b, values[1], 3)));
  check_gradients(p, values[1]);  // only one of the results is asked for
}

TEST_CASE("if that yields captured values and constants") {
  Problem p;
  Builder& b = p.b;
  const ValueId mask = p.input("mask", kInt, {4, 1, 1}, {1, 0, 0, 1});
  const ValueId x = p.param("x", kFloat, kOne);
  const ValueId layers = p.param("layers", kFloat, kLayers);
  const ValueId condition = op(b, OpKind::Equal, {mask, integer(b, 1)});
  const Extent domain{4, 1, 2};
  const ValueId y = make_if(
      b, condition, domain, {Yield::Element}, [&] { return std::vector{x}; }, [&] { return std::vector{layers}; })[0];
  check_gradients(p, ops::mul(b, y, y));
  const ValueId z = make_if(
      b, condition, domain, {Yield::Element}, [&] { return std::vector{number(b, 2)}; },
      [&] { return std::vector{x}; })[0];
  check_gradients(p, ops::mul(b, z, z));
}

TEST_CASE("the branch not taken sends nothing into a gradient") {
  Problem p;
  Builder& b = p.b;
  const ValueId x = p.input("x", kFloat, {4, 1, 1}, {0, -1, 4, std::numeric_limits<double>::infinity()});
  const ValueId table = p.param("table", kFloat, {4, 1, 1});
  p.data.at("table").data = {0, std::nan(""), 4, std::numeric_limits<double>::infinity()};
  const ValueId good = op(b, OpKind::Equal, {ops::coord(b, 0, {4, 1, 1}), integer(b, 2)});
  const ValueId y = make_if(
      b, good, {4, 1, 1}, {Yield::Element},
      [&] {
        const ValueId t = gather(b, table, ops::coord(b, 0, {4, 1, 1}));
        return std::vector{ops::add(b, op(b, OpKind::Sqrt, {x}), ops::div(b, number(b, 1), t))};
      },
      [&] { return std::vector{number(b, 0)}; })[0];
  const std::vector<ValueId> g = grad(b, y, number(b, 1), {x, table});
  const ValueId h = grad(b, g[0], number(b, 1), {x})[0];
  const ValueId k = grad(b, g[1], number(b, 1), {table})[0];
  const Images r = results(p, {{"x", g[0]}, {"table", g[1]}, {"xx", h}, {"tt", k}});
  CHECK(r.at("x").data == std::vector<double>{0, 0, 0.25, 0});
  CHECK(r.at("table").data == std::vector<double>{0, 0, -1.0 / 16, 0});
  CHECK(r.at("xx").data == std::vector<double>{0, 0, -1.0 / 32, 0});
  CHECK(r.at("tt").data == std::vector<double>{0, 0, 1.0 / 32, 0});
}

// --- reduce ---

TEST_CASE("reduce by sum with reads") {
  Problem p;
  Builder& b = p.b;
  const ValueId grid = p.param("grid", kFloat, kGrid);
  const ValueId one = p.param("one", kFloat, kOne);
  const ValueId table = p.param("table", kFloat, kRow);
  const ValueId picture = p.param("picture", kVec3, kGrid);
  const ValueId end = p.input("end", kInt, {4, 1, 1}, {0, 2, 5, 7});  // none, some, all, too many
  const ValueId place = position(b, kGrid);
  const auto sums = make_reduce(b, integer(b, 0), end, kGrid, {Yield::Sum, Yield::Sum}, [&](ValueId i) {
    const ValueId t = gather(b, table, i);
    const ValueId there = ops::add(b, place, ops::compose(b, {i, integer(b, 0)}, kIvec2));
    const ValueId c = gather(b, picture, there);
    const ValueId s = exp(b, ops::mul(b, ops::mul(b, t, grid), one));
    return std::vector{s, ops::mul(b, ops::mul(b, c, c), ops::splat(b, ops::mul(b, s, to_float(b, i)), 3))};
  });
  check_gradients(p, ops::mul(b, sums[1], ops::splat(b, sums[0], 3)), {.tolerance = 1e-7});
  check_gradients(p, sums[0]);
}

TEST_CASE("reduce by minimum and maximum") {
  for (const Yield how : {Yield::Min, Yield::Max}) {
    Problem p;
    Builder& b = p.b;
    const ValueId table = p.param("table", kFloat, kRow);
    p.data.at("table").data = {1.3, 0.7, -0.4, 0.2, -0.9};
    const ValueId grid = p.param("grid", kFloat, kGrid, 0.9, 1.1);
    const ValueId begin = p.input("begin", kInt, {4, 1, 1}, {0, 1, 3, 2});
    const ValueId end = p.input("end", kInt, {4, 1, 1}, {5, 4, 5, 2});
    const auto result = make_reduce(b, begin, end, kGrid, {how, Yield::Sum}, [&](ValueId i) {
      const ValueId t = gather(b, table, i);
      return std::vector{sin(b, ops::mul(b, t, grid)), ops::mul(b, t, t)};
    });
    // An empty range gives an infinity; it must not get into the differences.
    const ValueId finite =
        ops::select(b, less(b, op(b, OpKind::Abs, {result[0]}), number(b, 100)), result[0], number(b, 0));
    check_gradients(p, ops::mul(b, finite, result[1]));
    check_gradients(p, finite);
  }
}

TEST_CASE("reduce by extremes of vectors, and with an argmin beside them") {
  Problem p;
  Builder& b = p.b;
  const ValueId table = p.param("table", kVec3, kRow);
  std::vector<double>& data = p.data.at("table").data;
  for (size_t k = 0; k < data.size(); ++k) data[k] = 0.3 * static_cast<double>(k * 7 % 15) + 0.05 * data[k];
  const ValueId x = p.param("x", kFloat, kGrid, 0.9, 1.1);
  const ValueId y = make_reduce(b, integer(b, 0), integer(b, 5), kGrid, {Yield::Max}, [&](ValueId i) {
    return std::vector{ops::mul(b, ops::splat(b, x, 3), gather(b, table, i))};
  })[0];
  check_gradients(p, ops::mul(b, y, y));
  const auto three =
      make_reduce(b, integer(b, 0), integer(b, 5), kGrid, {Yield::Min, Yield::ArgMin, Yield::Max}, [&](ValueId i) {
        const ValueId d = ops::mul(b, x, op(b, OpKind::Dot, {gather(b, table, i), gather(b, table, i)}));
        return std::vector{d, d, d};
      });
  check_gradients(p, ops::mul(b, three[0], three[2]), {.tolerance = 1e-7});
}

TEST_CASE("the first trip wins a tie, and trips that lost send nothing") {
  Problem p;
  Builder& b = p.b;
  const ValueId table = p.param("table", kFloat, kRow);
  p.data.at("table").data = {std::nan(""), 2, 1, 1, std::numeric_limits<double>::infinity()};
  const ValueId low = make_reduce(b, integer(b, 1), integer(b, 5), kOne, {Yield::Min},
                                  [&](ValueId i) { return std::vector{gather(b, table, i)}; })[0];
  const ValueId none = make_reduce(b, integer(b, 3), integer(b, 3), kOne, {Yield::Min},
                                   [&](ValueId i) { return std::vector{gather(b, table, i)}; })[0];
  const ValueId g = grad(b, low, number(b, 1), {table})[0];
  const ValueId h = grad(b, none, number(b, 1), {table})[0];
  const Images r = results(p, {{"g", g}, {"h", h}});
  CHECK(r.at("g").data == std::vector<double>{0, 0, 1, 0, 0});
  CHECK(r.at("h").data == std::vector<double>{0, 0, 0, 0, 0});
}

// --- nesting ---

TEST_CASE("if in reduce") {
  Problem p;
  Builder& b = p.b;
  const ValueId grid = p.param("grid", kFloat, kGrid);
  const ValueId one = p.param("one", kFloat, kOne);
  const ValueId table = p.param("table", kFloat, kRow);
  const ValueId other = p.param("other", kFloat, kRow);
  const ValueId column = ops::coord(b, 0, kGrid);
  const ValueId y = make_reduce(b, integer(b, 0), integer(b, 6), kGrid, {Yield::Sum}, [&](ValueId i) {
    const ValueId local = ops::mul(b, gather(b, table, i), grid);
    const ValueId chosen = make_if(
        b, op(b, OpKind::LessEqual, {column, i}), kGrid, {Yield::Element},
        [&] { return std::vector{ops::mul(b, sin(b, local), gather(b, other, column))}; },
        [&] { return std::vector{ops::mul(b, local, ops::mul(b, one, gather(b, table, column)))}; })[0];
    return std::vector{ops::mul(b, chosen, chosen)};
  })[0];
  check_gradients(p, y, {.tolerance = 1e-7});
}

TEST_CASE("reduce in if") {
  Problem p;
  Builder& b = p.b;
  const ValueId grid = p.param("grid", kFloat, kGrid);
  const ValueId one = p.param("one", kFloat, kOne);
  const ValueId table = p.param("table", kFloat, kRow);
  p.data.at("table").data = {1.3, 0.7, -0.4, 0.2, -0.9};
  const ValueId column = ops::coord(b, 0, kGrid);
  const ValueId y = make_if(
      b, op(b, OpKind::Less, {column, integer(b, 2)}), kGrid, {Yield::Element},
      [&] {
        const ValueId local = exp(b, grid);
        const auto r = make_reduce(b, column, integer(b, 5), kGrid, {Yield::Sum, Yield::Min}, [&](ValueId i) {
          const ValueId t = ops::mul(b, gather(b, table, i), local);
          return std::vector{ops::mul(b, t, one), t};
        });
        return std::vector{ops::mul(b, r[0], r[1])};
      },
      [&] { return std::vector{ops::mul(b, grid, gather(b, table, column))}; })[0];
  check_gradients(p, y, {.tolerance = 1e-6});
}

TEST_CASE("reduce in reduce, whose inner one runs on fewer elements") {
  Problem p;
  Builder& b = p.b;
  const ValueId grid = p.param("grid", kFloat, kGrid);
  const ValueId row = p.param("row", kFloat, {4, 1, 1});
  const ValueId table = p.param("table", kFloat, kRow);
  const ValueId y = make_reduce(b, integer(b, 0), integer(b, 3), kGrid, {Yield::Sum}, [&](ValueId i) {
    const ValueId few = make_reduce(b, i, integer(b, 4), {4, 1, 1}, {Yield::Sum}, [&](ValueId j) {
      return std::vector{ops::mul(b, sin(b, ops::mul(b, row, gather(b, table, j))), gather(b, table, i))};
    })[0];
    return std::vector{ops::mul(b, ops::mul(b, few, few), grid)};
  })[0];
  check_gradients(p, y, {.tolerance = 1e-7});
}

TEST_CASE("scatter results of regions") {
  Problem p;
  Builder& b = p.b;
  const ValueId grid = p.param("grid", kFloat, kGrid);
  const ValueId table = p.param("table", kFloat, kRow);
  const ValueId column = ops::coord(b, 0, kGrid);
  const auto out = make_reduce(b, integer(b, 0), integer(b, 3), kGrid, {Yield::Sum, Yield::Scatter},
                               [&](ValueId i) {
                                 const ValueId local = ops::mul(b, grid, gather(b, table, i));
                                 const ValueId landed = make_if(
                                     b, op(b, OpKind::Less, {i, column}), kGrid, {Yield::Scatter},
                                     [&] {
                                       return std::vector{ops::add(b, i, column), ops::mul(b, local, local)};
                                     },
                                     [&] {
                                       return std::vector{integer(b, -1), number(b, 0)};
                                     },
                                     {kRow})[0];
                                 return std::vector{local, landed};
                               },
                               {kRow});
  check_gradients(p, ops::mul(b, out[1], table), {.tolerance = 1e-7});
  check_gradients(p, ops::mul(b, total(b, out[0]), out[1]), {.tolerance = 1e-7});
}

TEST_CASE("a region whose results depend on nothing that has a gradient") {
  Problem p;
  Builder& b = p.b;
  const ValueId x = p.param("x", kFloat, kGrid);
  const ValueId table = p.param("table", kFloat, kRow);
  const ValueId column = ops::coord(b, 0, kGrid);
  const ValueId y = make_if(
      b, op(b, OpKind::Less, {column, integer(b, 2)}), kGrid, {Yield::Element},
      [&] { return std::vector{op(b, OpKind::Floor, {ops::mul(b, x, number(b, 10))})}; },
      [&] { return std::vector{op(b, OpKind::Detach, {gather(b, table, column)})}; })[0];
  const std::vector<ValueId> g = grad(b, y, number(b, 1), {x, table});
  const Images r = results(p, {{"x", g[0]}, {"table", g[1]}});
  CHECK(r.at("x").data == std::vector<double>(12, 0.0));
  CHECK(r.at("table").data == std::vector<double>(5, 0.0));
}

TEST_CASE("matrices in regions") {
  Problem p;
  Builder& b = p.b;
  const dr::ir::Type matrix{Scalar::Float, 3, 2};
  const ValueId views = p.param("views", matrix, kLayers);
  const ValueId table = p.param("table", matrix, kRow);
  const ValueId x = p.param("x", kFloat, kStack);
  const ValueId column = ops::coord(b, 0, kStack);
  const ValueId y = make_reduce(b, integer(b, 0), integer(b, 3), kStack, {Yield::Sum}, [&](ValueId i) {
    return make_if(
        b, op(b, OpKind::Less, {i, column}), kStack, {Yield::Element},
        [&] {
          const ValueId m = gather(b, table, i);
          return std::vector{
              ops::mul(b, ops::extract(b, m, 0), ops::mul(b, ops::extract(b, views, 1), ops::splat(b, x, 3)))};
        },
        [&] { return std::vector{sin(b, ops::extract(b, views, 0))}; });
  })[0];
  check_gradients(p, ops::mul(b, y, y), {.tolerance = 1e-7});
}

TEST_CASE("extents may be symbols") {
  Builder b;
  const Extent vertices{Dim::symbol("V"), 1, 1}, faces{Dim::symbol("F"), 1, 1};
  const ValueId x = leaf(b, "x", kFloat, vertices);
  const ValueId scale = leaf(b, "scale", kFloat, kOne);
  const ValueId y = make_reduce(b, integer(b, 0), ops::dim_value(b, vertices.w), faces, {Yield::Sum}, [&](ValueId i) {
    return make_if(
        b, less(b, to_float(b, i), to_float(b, ops::coord(b, 0, faces))), faces, {Yield::Element},
        [&] { return std::vector{ops::mul(b, gather(b, x, i), scale)}; }, [&] { return std::vector{number(b, 0)}; });
  })[0];
  const std::vector<ValueId> g = grad(b, y, number(b, 1), {x, scale});
  Graph graph = b.graph();
  add_step(graph, "look", {{"x", g[0]}, {"scale", g[1]}, {"y", y}});
  const Graph done = differentiated(graph);
  dr::reference::Session session(done);
  Image three = dr::reference::zeros(kFloat, 3, 1, 1), two = dr::reference::zeros(kFloat, 1, 1, 1);
  three.data = {5, 7, 11};
  two.data = {2};
  bind_leaves(session, {{"x", three}, {"scale", two}});
  CHECK_FALSE(session.bind_symbol("F", 4).has_value());
  const Images r = run(session, "look");
  CHECK(r.at("y").data == std::vector<double>{0, 10, 24, 46});
  CHECK(r.at("x").data == std::vector<double>{6, 4, 2});
  CHECK(r.at("scale").data == std::vector<double>{40});
}

TEST_CASE("third derivatives") {
  Problem p;
  Builder& b = p.b;
  const ValueId x = p.param("x", kFloat, kOne);
  const ValueId table = p.param("table", kFloat, kRow);
  ValueId y = make_reduce(b, integer(b, 0), integer(b, 5), kOne, {Yield::Sum},
                          [&](ValueId i) { return std::vector{exp(b, ops::mul(b, x, gather(b, table, i)))}; })[0];
  for (int k = 0; k < 3; ++k) y = grad(b, y, number(b, 1), {x})[0];
  const Images r = results(p, {{"y", y}});
  double expected = 0;
  for (const double t : p.data.at("table").data) expected += t * t * t * std::exp(t * p.data.at("x").data[0]);
  CHECK(r.at("y").data[0] == Approx(expected).epsilon(1e-12));
}
