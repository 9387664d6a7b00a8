// SPDX-License-Identifier: Apache-2.0
// On random graphs, `simplify` leaves a sound graph that computes the same and that it finds nothing more to do in.
#include <cmath>
#include <cstdlib>
#include <random>

#include "compiler/passes/passes.h"
#include "compiler/reference/evaluate.h"
#include "tests/sanitized.h"
#include "tests/unit/passes/random_graph.h"
#include "tests/unit/passes/text.h"

using namespace dr::ir;
namespace reference = dr::reference;

namespace {

reference::StepResult run(const Graph& graph, uint64_t seed) {
  std::mt19937_64 random(seed);
  reference::Session session(graph);
  for (const Leaf& leaf : graph.leaves) {
    reference::Image image =
        reference::zeros(leaf.type, leaf.extent.w.constant(), leaf.extent.h.constant(), leaf.extent.l.constant());
    for (double& number : image.data) {
      const int drawn = static_cast<int>(random() % 9) - 3;
      number = leaf.type.is_bool() ? drawn & 1 : drawn;
      if (leaf.type.is_float() && drawn == 5) number = INFINITY;
      if (leaf.type.is_float() && drawn == 4) number = NAN;
    }
    const auto error = session.bind(leaf.name, std::move(image));
    if (error) FAIL(*error);
  }
  auto result = session.run("run");
  if (const auto* error = std::get_if<reference::EvalError>(&result)) FAIL(error->message);
  return std::get<reference::StepResult>(std::move(result));
}

bool same(double a, double b) { return a == b || (std::isnan(a) && std::isnan(b)); }

void check(uint64_t seed) {
  const Graph before = dr::passes_test::random_graph(seed);
  const Graph after = dr::passes::simplify(before);
  CAPTURE(seed, print(before), print(after));
  REQUIRE(dr::passes::verify(after) == std::vector<std::string>{});
  REQUIRE(print(dr::passes::simplify(after)) == print(after));
  const auto x = run(before, seed), y = run(after, seed);
  for (const auto& [name, image] : x.outputs) {
    const auto& other = y.outputs.at(name);
    REQUIRE(image.data.size() == other.data.size());
    for (size_t i = 0; i < image.data.size(); ++i) {
      CAPTURE(name, i, image.data[i], other.data[i]);
      REQUIRE(same(image.data[i], other.data[i]));
    }
  }
}

}  // namespace

TEST_CASE("simplify keeps what random graphs compute") {
  if (const char* seed = std::getenv("DR_SEED")) return check(std::strtoull(seed, nullptr, 10));
  for (int seed = 0; seed < dr::repeats(1000); ++seed) check(static_cast<uint64_t>(seed));
}
