// SPDX-License-Identifier: Apache-2.0
// Measurements, run by name only: reference_test "[benchmark]".
#include <chrono>
#include <cstdio>

#include "tests/catch.h"
#include "tests/unit/reference/programs.h"
#include "tests/unit/reference/support.h"

namespace dr::reference_test {
namespace {

double seconds(const ir::Graph& graph, const Images& leaves, int threads) {
  reference::Session session(graph);
  for (const auto& [name, data] : leaves) REQUIRE(!session.bind(name, data));
  reference::Options options;
  options.threads = threads;
  double best = 1e9;
  for (int run = 0; run < 3; ++run) {
    const auto begin = std::chrono::steady_clock::now();
    REQUIRE(std::holds_alternative<reference::StepResult>(session.run("s", options)));
    best = std::min(best, std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
  }
  return best;
}

TEST_CASE("time of large programs", "[.][benchmark]") {
  const ir::Graph chain = parse(chain_program(300)), mixed = parse(mixed_program());
  for (int threads : {1, 2}) {
    Images leaves{{"x", reference::zeros(ir::kFloat, 256, 256, 6)}, {"k", reference::zeros(ir::kFloat, 256, 1, 1)}};
    for (size_t i = 0; i < leaves.at("x").data.size(); ++i) leaves.at("x").data[i] = static_cast<double>(i % 977) / 977;
    std::printf("300 element-wise ops on 256x256x6, %d threads: %.3f s\n", threads, seconds(chain, leaves, threads));
    leaves = {{"x", reference::zeros(ir::vec(3), 256, 256, 6)}, {"n", reference::zeros(ir::kInt, 256, 256, 1)}};
    for (size_t i = 0; i < leaves.at("n").data.size(); ++i) leaves.at("n").data[i] = static_cast<double>(i % 9);
    std::printf("regions and scatters on 256x256x6, %d threads: %.3f s\n", threads, seconds(mixed, leaves, threads));
  }
}

}  // namespace
}  // namespace dr::reference_test
