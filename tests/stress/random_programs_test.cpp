// SPDX-License-Identifier: Apache-2.0
// Random programs, differentially: the evaluator in float64 against itself with every result rounded to float32, and
// against devices, where ways to compile (fused, naive, ablations, lowerings) must give the same bits.
// DR_STRESS_EVALUATOR and DR_STRESS_DEVICE set how many programs run, DR_SEED the first seed. `fuzz_programs` goes on
// for any time, in more ways and sizes, and cuts down what fails.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>

#include "tests/catch.h"
#include "tests/device/devices.h"
#include "tests/stress/problem.h"

using namespace dr;
using test::distance;
using test::evaluate;
using test::Images;
using test::Problem;
using test::run_on;
using test::Way;

namespace {

// An error is of rounding as long as it is below so much of the largest number of its result.
constexpr double kTolerance = 1e-5;
// Where two numbers that a program compares differ by rounding alone, float32 may decide otherwise than float64. So
// many smooth programs of a thousand may differ by more.
constexpr double kDecided = 4;

uint64_t number(const char* name, uint64_t otherwise) {
  const char* text = std::getenv(name);
  return text != nullptr ? std::strtoull(text, nullptr, 10) : otherwise;
}

// What came of many programs.
struct Tally {
  std::vector<double> smooth;
  uint64_t exact = 0;
  std::vector<uint64_t> beyond;  // seeds
  void add(uint64_t seed, const Problem& p, double found) {
    if (p.exact) {
      ++exact;
      CHECK(found == 0);
    } else {
      CHECK(std::isfinite(found));
      smooth.push_back(found);
      if (found > kTolerance) beyond.push_back(seed);
    }
  }
  void report(const char* what) {
    std::sort(smooth.begin(), smooth.end());
    const auto share = [&](double p) {
      return smooth[static_cast<size_t>(p * static_cast<double>(smooth.size() - 1))];
    };
    std::printf("%-24s %llu programs agree exactly; %zu smooth ones: median %.1e, 99%% %.1e, worst %.1e, %zu beyond %g",
                what, static_cast<unsigned long long>(exact), smooth.size(), share(0.5), share(0.99), share(1),
                beyond.size(), kTolerance);
    for (const uint64_t seed : beyond) std::printf(" %llu", static_cast<unsigned long long>(seed));
    std::printf("\n");
    CHECK(static_cast<double>(beyond.size()) <= std::ceil(kDecided * 1e-3 * static_cast<double>(smooth.size())));
    CHECK(share(0.5) > 0);  // float32 is not float64
  }
};

}  // namespace

TEST_CASE("the evaluator in float32 is near itself in float64") {
  const uint64_t first = number("DR_SEED", 1), count = number("DR_STRESS_EVALUATOR", 1000);
  Tally tally;
  for (uint64_t seed = first; seed < first + count; ++seed) {
    INFO("DR_SEED=" << seed);
    const Problem p = test::random_problem(seed);
    const ir::Graph graph = test::lowered(p.graph);
    const Images exact = evaluate(p, graph, false);
    tally.add(seed, p, distance(evaluate(p, graph, true), exact));
    if (p.exact) continue;
    const double product = exact.at("product").data[0], changes = exact.at("changes").data[0];
    CHECK(std::abs(product - changes) <= 1e-12 * std::max(1.0, std::abs(product)));
  }
  if (count > 1) tally.report("float32 evaluator");
}

TEST_CASE("devices are near the evaluator, and every way to compile gives the same bits") {
  const uint64_t first = number("DR_SEED", 1), count = number("DR_STRESS_DEVICE", 12);
  const std::vector<Way> ways = {
      {"fragment", "fused", {}},        {"compute", "naive", {}},  {"fragment", "fused", {"substages", "remat"}},
      {"compute", "fused", {"stages"}}, {"fragment", "naive", {}}, {"compute", "fused", {"cache", "remat"}}};
  for (const test::NamedDevice& device : test::devices()) {
    const auto loaded = target::load_profile(device.name);
    const auto& profile = std::get<target::Profile>(loaded);
    Tally tally;
    for (uint64_t seed = first; seed < first + count; ++seed) {
      INFO("DR_SEED=" << seed << " on " << device.name);
      const Problem p = test::random_problem(seed);
      const ir::Graph graph = test::lowered(p.graph);
      const Images expected = evaluate(p, graph, false);
      const Images found = run_on(device.device, p, graph, profile, expected, {});
      tally.add(seed, p, distance(found, expected));
      const Way& way = p.exact ? ways[(seed / 2) % ways.size()] : ways[seed % 4 == 1 ? 0 : 3];
      INFO(way.str());
      const Images other = run_on(device.device, p, graph, profile, expected, way);
      CHECK(distance(other, found) == 0);
    }
    for (const std::string& message : device.device.validation_messages()) FAIL("validation: " << message);
    if (count > 1) tally.report(device.name.c_str());
  }
}
