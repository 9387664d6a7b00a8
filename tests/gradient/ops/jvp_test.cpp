// SPDX-License-Identifier: Apache-2.0
// Forward mode against reverse mode for every op with a derivative: <w, J v> = <J^T w, v>, to rounding. `jvp` is the
// adjoint of what leads from a seed to the gradient, so that this asks of each adjoint rule whether it is linear in
// the adjoint that it is given, and of the rules of the ops that it is made of whether they undo it.
#include <algorithm>
#include <cmath>

#include "tests/catch.h"
#include "tests/gradient/build.h"
#include "tests/gradient/check.h"
#include "tests/gradient/ops/subject.h"

using namespace dr;
using namespace dr::gradient_test;

namespace {

constexpr double kTolerance = 1e-12;  // of the sum of the terms' sizes
constexpr int64_t kElements = 40;

struct Transposed {
  Builder b;
  Images data;
  std::vector<ValueId> xs;  // the float ones

  ValueId image(const std::string& name, Type type, const Extent& extent, Random& random, double low, double high) {
    reference::Image drawn = random.image(type, extent, low, high);
    if (type.is_bool())
      for (double& x : drawn.data) x = x < 0.5 * (low + high) ? 0 : 1;
    data.emplace(name, std::move(drawn));
    return leaf(b, name, type, extent);
  }
};

void check(Transposed& p, ValueId y, Random& random) {
  Builder& b = p.b;
  const ir::ValueInfo info = b.value(y);
  const ValueId w = p.image("w", info.type, info.extent, random, -1, 1);
  std::vector<std::pair<std::string, ValueId>> outputs{{"y", y}};
  const std::vector<ValueId> back = grad(b, y, w, p.xs);
  for (size_t k = 0; k < p.xs.size(); ++k) {
    const ir::ValueInfo of = b.value(p.xs[k]);
    const std::string number = std::to_string(k);
    const ValueId along = p.image("v" + number, of.type, of.extent, random, -1, 1);
    outputs.emplace_back("forward" + number, jvp(b, y, p.xs[k], along));
    outputs.emplace_back("back" + number, back[k]);
  }
  gradient_test::add_step(b.graph(), "run", outputs);
  const ir::Graph graph = differentiated(b.graph());
  reference::Session session(graph);
  bind_leaves(session, p.data);
  const Images found = run(session, "run");

  double left = 0, right = 0, terms = 0;
  const auto add = [&](double& sum, const reference::Image& x, const reference::Image& other) {
    REQUIRE(x.data.size() == other.data.size());
    for (size_t i = 0; i < x.data.size(); ++i) {
      sum += x.data[i] * other.data[i];
      terms += std::abs(x.data[i] * other.data[i]);
    }
  };
  for (size_t k = 0; k < p.xs.size(); ++k) {
    const std::string number = std::to_string(k);
    add(left, p.data.at("w"), found.at("forward" + number));
    add(right, found.at("back" + number), p.data.at("v" + number));
  }
  INFO("<w, J v> = " << left << ", <J^T w, v> = " << right << ", sum of the terms' sizes " << terms);
  CHECK(std::isfinite(terms));
  CHECK(terms > 0);
  CHECK(std::abs(left - right) <= kTolerance * terms);
}

}  // namespace

TEST_CASE("jvp is the transpose of grad for element-wise ops") {
  for (const ir::OpKind kind : ops_test::elementwise_kinds()) {
    const ops::OpInfo& info = ops::info(kind);
    if (!info.differentiable || kind == ir::OpKind::Detach) continue;
    size_t number = 0;
    for (const Form& form : float_forms(kind)) {
      INFO(ir::op_name(kind) << ", form " << number);
      Random random(17 + 100 * static_cast<uint64_t>(kind) + number++);
      Transposed p;
      std::vector<ValueId> operands;
      for (size_t k = 0; k < form.operands.size(); ++k) {
        const ops::Domain domain = k < info.domains.size() ? info.domains[k] : ops::Domain{};
        const Type type = form.operands[k];
        operands.push_back(p.image("x" + std::to_string(k), type, {kElements, 1, 1}, random, domain.low, domain.high));
        if (type.is_float()) p.xs.push_back(operands.back());
      }
      const ValueId y = ops::emit(p.b, kind, operands, form.attrs);
      if (kind == ir::OpKind::Sign || kind == ir::OpKind::Floor || kind == ir::OpKind::Ceil ||
          kind == ir::OpKind::Round || kind == ir::OpKind::Trunc)
        continue;  // flat
      if (kind == ir::OpKind::Normalize && form.result.is_scalar()) continue;
      check(p, y, random);
    }
  }
}

TEST_CASE("jvp is the transpose of grad for ops on images and for regions") {
  const Extent extent{6, 5, 2};
  for (const Type type : {ir::kFloat, ir::vec(3)}) {
    const auto form = [&](const char* name, const auto& make) {
      INFO(name << " of " << type.str());
      Random random(5);
      Transposed p;
      p.xs.push_back(p.image("x", type, extent, random, -1, 1));
      p.xs.push_back(p.image("z", type, extent, random, -1, 1));
      const ValueId product = ops::mul(p.b, p.xs[0], p.xs[1]);
      const ValueId x = ops::coord(p.b, 0, extent), row = ops::coord(p.b, 1, extent);
      const ValueId index = ops::compose(p.b, {ops::mul(p.b, x, row), row}, ir::vec(2, ir::Scalar::Int));
      check(p, make(p.b, product, index, x), random);
    };
    using V = ValueId;
    form("gather", [](Builder& b, V y, V i, V) { return ops::emit(b, ir::OpKind::Gather, {y, i}); });
    form("scatter_add", [&](Builder& b, V y, V i, V) {
      return ops::emit(b, ir::OpKind::ScatterAdd, {i, y}, dims(extent));
    });
    form("shift", [](Builder& b, V y, V, V) { return ops::emit(b, ir::OpKind::Shift, {y}, ints({1, -2})); });
    for (const auto kind : {ir::OpKind::ReduceSum, ir::OpKind::ReduceMin, ir::OpKind::ReduceMax})
      form("reduction", [&](Builder& b, V y, V, V) { return ops::emit(b, kind, {y}, ints({1, 0, 1})); });
    form("broadcast", [&](Builder& b, V y, V, V) {
      const V sum = ops::emit(b, ir::OpKind::ReduceSum, {y}, ints({1, 0, 0}));
      return ops::broadcast(b, sum, extent);
    });
    form("if", [&](Builder& b, V y, V i, V x) {
      const V low = ops::emit(b, ir::OpKind::Less, {x, ops::constant(b, ir::kInt, 3.0)});
      const auto then = [&] { return std::vector{ops::mul(b, y, ops::emit(b, ir::OpKind::Gather, {y, i}))}; };
      const auto otherwise = [&] { return std::vector{ops::emit(b, ir::OpKind::Sin, {y})}; };
      return make_if(b, low, extent, {ir::Yield::Element}, then, otherwise)[0];
    });
    for (const auto how : {ir::Yield::Sum, ir::Yield::Min, ir::Yield::Max})
      form("reduce", [&](Builder& b, V y, V, V x) {
        const auto body = [&](V trip) {
          const V at = ops::compose(b, {trip, x}, ir::vec(2, ir::Scalar::Int));
          return std::vector{ops::mul(b, y, ops::emit(b, ir::OpKind::Gather, {y, at}))};
        };
        const V begin = ops::constant(b, ir::kInt, 0.0), end = ops::constant(b, ir::kInt, 4.0);
        return make_reduce(b, begin, end, extent, {how}, body)[0];
      });
    form("fold", [&](Builder& b, V y, V, V x) {
      const V begin = ops::constant(b, ir::kInt, 0.0), end = ops::constant(b, ir::kInt, 4.0);
      const FoldBody body = [&](V trip, const std::vector<V>& states) {
        const V at = ops::compose(b, {trip, x}, ir::vec(2, ir::Scalar::Int));
        const V read = ops::emit(b, ir::OpKind::Gather, {y, at});
        return Trip{{}, {ops::emit(b, ir::OpKind::Sin, {ops::add(b, states[0], read)})}};
      };
      return make_fold(b, begin, end, extent, {y}, body, 4)[0];
    });
  }
}
