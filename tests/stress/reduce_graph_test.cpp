// SPDX-License-Identifier: Apache-2.0
// Random programs are cut down to the few ops that a fault needs, and every graph on the way is sound.
#include "tests/stress/reduce_graph.h"

#include <algorithm>

#include "compiler/ir/parse.h"
#include "compiler/ir/print.h"
#include "compiler/passes/passes.h"
#include "tests/catch.h"
#include "tests/stress/problem.h"
#include "tests/stress/rewrite_graph.h"

using namespace dr;
using ir::OpKind;

namespace {

// A fault that hangs on two ops: `one` reads, at whatever distance, what `other` makes.
bool reads(const ir::Graph& graph, OpKind one, OpKind other) {
  std::vector<bool> made(graph.value_count());
  bool found = false;
  for (const ir::OpId id : test::all_ops(graph)) {
    const ir::Op& op = graph.op(id);
    const bool after = std::ranges::any_of(op.operands, [&](ir::ValueId x) { return made[x.index]; });
    found |= after && op.kind == one;
    for (const ir::ValueId result : op.results) made[result.index] = after || op.kind == other;
  }
  return found;
}

bool inside(const ir::Graph& graph, OpKind kind) {
  return std::ranges::any_of(test::all_ops(graph), [&](ir::OpId id) {
    return graph.op(id).kind == kind && graph.op(id).parent != graph.root();
  });
}

}  // namespace

TEST_CASE("what has nothing to do with a fault goes") {
  size_t reduced = 0;
  for (uint64_t seed = 1; seed <= 40; ++seed) {
    INFO("seed " << seed);
    const ir::Graph graph = test::rewritten(test::random_problem(seed).graph, {}).value();
    for (int fault = 0; fault < 3; ++fault) {
      size_t asked = 0;
      const auto fails = [&](const ir::Graph& g) {
        ++asked;
        REQUIRE(passes::verify(g).empty());
        const std::string text = ir::print(g);
        REQUIRE(ir::print(std::get<ir::Graph>(ir::parse(text))) == text);
        if (fault == 0) return reads(g, OpKind::Add, OpKind::Mul);
        return inside(g, fault == 1 ? OpKind::Select : OpKind::Gather);
      };
      if (!fails(graph)) continue;
      const ir::Graph least = test::reduce_graph(graph, fails, 60);
      INFO(ir::print(least));
      CHECK(fails(least));
      // The two ops, or the op with the region around it, and what gives operands of their types.
      CHECK(test::ops_of(least) <= 8);
      CHECK(least.steps[0].outputs.size() == 1);
      CHECK(asked < 2000);
      ++reduced;
    }
  }
  CHECK(reduced > 30);
}
