// SPDX-License-Identifier: Apache-2.0
// Building and copying graphs, what regions capture, what is live.
#include "compiler/ir/graph.h"

#include "compiler/ir/print.h"
#include "tests/catch.h"

using namespace dr::ir;

namespace {

const Extent kImage{Dim::symbol("W"), Dim::symbol("H"), 1};

ValueId add(Builder& b, OpKind kind, std::vector<ValueId> operands, Extent extent = {}, Type type = kFloat) {
  const ResultType result{type, extent};
  const OpId op = b.add(kind, std::move(operands), {&result, 1});
  return b.graph().op(op).results[0];
}

// An If over kImage that yields `then_value` or a negation made inside.
struct IfGraph {
  Builder b;
  ValueId condition, x, unused, negated, chosen;
  OpId op;

  IfGraph() {
    condition = add(b, OpKind::Const, {}, {}, kBool);
    x = add(b, OpKind::Leaf, {}, kImage);
    unused = add(b, OpKind::Leaf, {}, kImage);
    const RegionId then_region = b.begin_region({});
    b.end_region({x});
    const RegionId else_region = b.begin_region({});
    negated = add(b, OpKind::Neg, {x}, kImage);
    b.set_name(negated, "negated");
    b.end_region({negated});
    const ResultType result{kFloat, kImage};
    op = b.add(OpKind::If, {condition}, {&result, 1}, {.dims = {kImage.w, kImage.h, 1}, .yields = {Yield::Element}},
               {then_region, else_region});
    chosen = b.graph().op(op).results[0];
    b.set_name(chosen, "chosen");
  }
};

}  // namespace

TEST_CASE("every op kind has a name of its own") {
  for (OpKind kind : all_op_kinds()) {
    CHECK_FALSE(op_name(kind).empty());
    CHECK(op_kind(op_name(kind)) == kind);
  }
  CHECK_FALSE(op_kind("no such op"));
}

TEST_CASE("the builder enters ops, values and regions") {
  const IfGraph g;
  const Graph& graph = g.b.graph();
  const Op& op = graph.op(g.op);
  CHECK(op.parent == graph.root());
  CHECK(graph.region(op.regions[1]).parent == g.op);
  CHECK(graph.value(g.negated).region == op.regions[1]);
  CHECK(graph.value(g.chosen).op == g.op);
  CHECK(graph.value(g.chosen).name == "chosen");
  CHECK(graph.region(graph.root()).ops.size() == 4);
  CHECK(graph.region_count() == 3);
}

TEST_CASE("ops without a span get the builder's") {
  Builder b;
  const dr::dsl::Span span{{0}, 3, 5};
  b.set_span(span);
  const ValueId x = add(b, OpKind::StepIndex, {});
  CHECK(b.graph().op(b.value(x).op).span == span);
}

TEST_CASE("regions capture what they use and do not define") {
  IfGraph g;
  const Op op = g.b.graph().op(g.op);
  CHECK(captures(g.b.graph(), op.regions[0]) == std::vector<ValueId>{g.x});
  CHECK(captures(g.b.graph(), op.regions[1]) == std::vector<ValueId>{g.x});

  // Through a region inside a region: the inner one's capture of the outer one's value is no capture of the outer one.
  const RegionId outer = g.b.begin_region({});
  const ValueId local = add(g.b, OpKind::Neg, {g.unused}, kImage);
  const RegionId inner = g.b.begin_region({});
  g.b.end_region({local});
  const RegionId other = g.b.begin_region({});
  g.b.end_region({g.chosen});
  const ResultType result{kFloat, kImage};
  const OpId nested = g.b.add(OpKind::If, {g.condition}, {&result, 1}, {.yields = {Yield::Element}}, {inner, other});
  g.b.end_region({g.b.graph().op(nested).results[0]});
  CHECK(captures(g.b.graph(), inner) == std::vector<ValueId>{local});
  CHECK(captures(g.b.graph(), outer) == std::vector<ValueId>{g.condition, g.unused, g.chosen});
}

TEST_CASE("live ops are those that the roots need, through regions too") {
  IfGraph g;
  const auto live = [&](ValueId id, const std::vector<bool>& ops) {
    return static_cast<bool>(ops[g.b.value(id).op.index]);
  };
  const auto of_chosen = live_ops(g.b.graph(), std::vector<ValueId>{g.chosen});
  CHECK(live(g.chosen, of_chosen));
  CHECK(live(g.x, of_chosen));
  CHECK(live(g.condition, of_chosen));
  CHECK_FALSE(live(g.unused, of_chosen));

  g.b.graph().steps.push_back({"one", {{"out", g.x}}, {}});
  g.b.graph().steps.push_back({"two", {}, {{0, g.unused}}});
  const auto of_steps = live_ops(g.b.graph(), {});
  CHECK(live(g.x, of_steps));
  CHECK(live(g.unused, of_steps));
  CHECK_FALSE(live(g.chosen, of_steps));
}

TEST_CASE("a copied op has its own regions, and keeps names and spans") {
  IfGraph g;
  const Graph from = std::move(g.b).finish();
  Builder to;
  ValueMap map(from.value_count());
  for (OpId op : from.region(from.root()).ops) copy_op(from, op, to, map);
  CHECK(print(to.graph()) == print(from));
  CHECK(to.value(map[g.chosen]).name == "chosen");
  CHECK(to.value(map[g.negated]).name == "negated");

  // With an operand replaced, captures go through the map as well.
  map.set(g.x, map[g.unused]);
  copy_op(from, g.op, to, map);
  const Op& copy = to.graph().op(to.value(map[g.chosen]).op);
  CHECK(captures(to.graph(), copy.regions[0]) == std::vector<ValueId>{map[g.unused]});
}

TEST_CASE("a copied scatter is an accumulation inside a region only") {
  Builder b;
  const ValueId i = add(b, OpKind::Coord, {}, kImage, kInt);
  const RegionId body = b.begin_region(std::vector<ResultType>{{kInt, {}}});
  b.end_region({i, i});
  const ResultType image{kInt, {4, 1, 1}};
  const OpId reduce =
      b.add(OpKind::Reduce, {i, i}, {&image, 1},
            {.ints = {-1}, .dims = {kImage.w, kImage.h, 1, 4, 1, 1}, .yields = {Yield::Scatter}}, {body});
  const Graph from = std::move(b).finish();

  Builder to;
  ValueMap map(from.value_count());
  copy_op(from, from.value(i).op, to, map);
  to.begin_region({});
  copy_op(from, reduce, to, map);
  CHECK(to.value(map[from.op(reduce).results[0]]).accumulation);
  to.end_region({});
  copy_op(from, reduce, to, map);
  CHECK_FALSE(to.value(map[from.op(reduce).results[0]]).accumulation);
}

TEST_CASE("leaves and steps are found by name") {
  Graph graph;
  graph.leaves.push_back({Leaf::Kind::Param, "a", kFloat, {}, {}, {}});
  graph.leaves.push_back({Leaf::Kind::Input, "b", kFloat, {}, {}, {}});
  graph.steps.push_back({"fit", {}, {}});
  CHECK(graph.leaf_index("b") == 1u);
  CHECK_FALSE(graph.leaf_index("c"));
  CHECK(graph.step_index("fit") == 0u);
  CHECK_FALSE(graph.step_index("a"));
}
