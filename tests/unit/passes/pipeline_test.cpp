// SPDX-License-Identifier: Apache-2.0
// The runner of passes: order, the hook, and what it does with a pass that breaks a graph.
#include "compiler/ir/internal_error.h"
#include "compiler/passes/passes.h"
#include "tests/unit/passes/text.h"

using namespace dr::ir;
using namespace dr::passes;
using dr::passes_test::read;

namespace {

constexpr std::string_view kSquare = R"(leaf x : float[V] param
%0 : float[V] = leaf text "x"
%1 : float[V] = mul %0, %0
%2 : float = const floats [1]
%3 : float[V] = broadcast %2 dims [V, 1, 1]
%4 : float[V] = grad %1, %3, %0
step s {
  output g %4
}
)";

Graph break_it(const Graph& graph, const Skips&) {
  Graph broken = graph;
  broken.steps.push_back(broken.steps[0]);
  return broken;
}

}  // namespace

TEST_CASE("the default passes run in order and leave no grad") {
  std::vector<std::string> names;
  const Graph graph = run_passes(read(kSquare), default_passes(),
                                 {.after = [&](std::string_view name, const Graph& after, double milliseconds) {
                                   names.emplace_back(name);
                                   CHECK(verify(after).empty());
                                   CHECK(milliseconds >= 0);
                                 }});
  CHECK(names == std::vector<std::string>{"simplify", "differentiate", "invert-scatters", "split-scatters", "simplify",
                                          "group-sums", "hoist-indices"});
  CHECK(print(graph).find("grad") == std::string::npos);
}

TEST_CASE("no pass, no change") { CHECK(print(run_passes(read(kSquare), {})) == kSquare); }

TEST_CASE("a graph that a pass breaks is an internal error with the pass's name") {
  const Pass passes[] = {{"break_it", break_it}};
  CHECK(verify(run_passes(read(kSquare), passes, {.verify_each = false})).size() == 1);

  try {
    run_passes(read(kSquare), passes);
    FAIL("no error");
  } catch (const InternalError& error) {
    CHECK_THAT(error.what(),
               Catch::Matchers::Contains("graph fails verification after pass break_it\n  two steps are named 's'"));
  }
}
