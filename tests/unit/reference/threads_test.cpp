// SPDX-License-Identifier: Apache-2.0
// Results that do not depend on the number of threads, and the pool itself.
#include <algorithm>
#include <cstring>
#include <random>

#include "compiler/reference/workers.h"
#include "tests/catch.h"
#include "tests/unit/reference/programs.h"
#include "tests/unit/reference/support.h"

namespace dr::reference_test {
namespace {

Image noise(std::string_view type, int64_t w, int64_t h, int64_t l, uint64_t seed, int range = 0) {
  Image image = reference::zeros(ir::Type::parse(type).value(), w, h, l);
  std::mt19937_64 engine(seed);
  for (double& v : image.data) {
    v = range > 0 ? static_cast<double>(engine() % static_cast<uint64_t>(range))
                  : static_cast<double>(engine() >> 11) * 0x1p-53 - 0.5;
  }
  return image;
}

TEST_CASE("results do not depend on the number of threads") {
  const ir::Graph mixed = parse(mixed_program()), chain = parse(chain_program(40));
  const Images leaves{{"x", noise("vec3", 97, 61, 3, 1)}, {"n", noise("int", 97, 61, 1, 2, 12)}};
  const Images chain_leaves{{"x", noise("float", 97, 161, 3, 3)}, {"k", noise("float", 97, 1, 1, 4)}};
  reference::Options one;
  one.threads = 1;
  const Images expected = run(mixed, leaves, one), expected_chain = run(chain, chain_leaves, one);
  for (int threads : {2, 3, 7}) {
    reference::Options several;
    several.threads = threads;
    const Images out = run(mixed, leaves, several);
    for (const auto& [name, image] : expected) {
      INFO(name << " with " << threads << " threads");
      CHECK(out.at(name).data == image.data);
    }
    const Images out_chain = run(chain, chain_leaves, several);
    // NaNs compare unequal, so bytes are compared.
    const auto &a = out_chain.at("r").data, &b = expected_chain.at("r").data;
    CHECK((a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size() * sizeof(double)) == 0));
  }
}

TEST_CASE("workers do each task once") {
  for (int threads : {1, 2, 5}) {
    reference::Workers workers(threads);
    for (const size_t tasks : {0u, 1u, 2u, 1000u}) {
      std::vector<std::atomic<int>> seen(tasks);
      workers.run(tasks, [&](size_t task, size_t worker) {
        if (worker < workers.count()) ++seen[task];
      });
      CHECK(std::all_of(seen.begin(), seen.end(), [](const auto& n) { return n == 1; }));
    }
  }
}

TEST_CASE("a turnstile lets tasks pass in order") {
  reference::Workers workers(4);
  reference::Turnstile turnstile;
  std::vector<size_t> order;
  workers.run(200, [&](size_t task, size_t) {
    turnstile.wait_for(task);
    order.push_back(task);
    turnstile.leave(task);
  });
  REQUIRE(order.size() == 200);
  CHECK(std::is_sorted(order.begin(), order.end()));
}

}  // namespace
}  // namespace dr::reference_test
