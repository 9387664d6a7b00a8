// SPDX-License-Identifier: Apache-2.0
// Sums of few elements are rounded once, on every device and by every form of scatter_add: against whole numbers of any
// size, on 100,000 sums; Inf, NaN, zeros, subnormals and sums beyond the largest float as IEEE's sums have them.
#include <algorithm>
#include <bit>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <random>

#include "compiler/backend/bundle/bundle.h"
#include "compiler/target/profile.h"
#include "runtime/jit/reference_program.h"
#include "runtime/runtime.h"
#include "tests/catch.h"
#include "tests/device/compile.h"
#include "tests/device/devices.h"
#include "tests/exact_sum.h"

using namespace dr;
using io::Array;
using test::must;

namespace {

constexpr int kTargets = 1000;

// The index of `moving` fits no table; an update takes it as it was added up.
const char* const kText = R"(edition 1;
input index : int[S];
input x : float[S];
input minus_x : float[S];
param held : float[1000] = 0.0;
param zero : int = 0;
let plain = scatter_add(index, x, 1000);
let pairs = scatter_add(ivec2(index % 100, index / 100), vec2(x, minus_x), 100, 10);
let moving = scatter_add(index + zero, x, 1000);
step run { output plain, pairs; }
step move { zero <- 2 * zero; output moving; }
step hold { zero <- 2 * zero; held <- if zero == 0 { moving } else { 1.0 }; }
)";

struct Road {
  std::string name, profile, scatter;
};

std::string written(const target::Profile& profile, const std::string& name) {
  const auto path = (std::filesystem::path(DR_BUILD_DIR) / ("few_sums_" + name + ".json")).string();
  std::ofstream(path) << target::write_profile(profile);
  return path;
}

// With and without 64-bit integers, lanes that join what they add, a GPU; all forms but float atomics.
std::vector<Road> roads(const std::string& device) {
  const auto load = [](const char* name) { return std::get<target::Profile>(target::load_profile(name)); };
  auto narrow = load("swiftshader");
  narrow.loop_trips = load("lavapipe").loop_trips;
  auto joined = narrow;
  joined.subgroup_arithmetic = true;
  joined.costs.atomic_add_ns = joined.costs.compute_operations_per_ns = 1000;
  auto gpu = joined;
  gpu.subgroup_size = 32;
  std::vector<Road> out{{"narrow", written(narrow, "narrow"), "auto"},
                        {"narrow", written(narrow, "narrow"), "exact"},
                        {"rows", written(narrow, "narrow"), "rows"},
                        {"joined", written(joined, "joined"), "exact"},
                        {"gpu", written(gpu, "gpu"), "auto"}};
  if (device != "lavapipe") return out;
  auto wide = load("lavapipe");
  wide.subgroup_arithmetic = true;
  wide.costs.atomic_add_ns = wide.costs.compute_operations_per_ns = 1000;
  out.insert(out.begin(), {{"wide", "lavapipe", "auto"}, {"wide, joined", written(wide, "wide"), "exact"}});
  return out;
}

struct Data {
  std::vector<int32_t> index;
  std::vector<float> x;
  std::vector<uint32_t> sums;  // of each target, as bits
};

Data shuffled(Data data, std::mt19937& random) {
  for (size_t k = data.x.size(); k-- > 1;) {
    const size_t other = random() % (k + 1);
    std::swap(data.x[k], data.x[other]);
    std::swap(data.index[k], data.index[other]);
  }
  return data;
}

Data made(std::mt19937& random) {
  Data data;
  for (int target = 0; target < kTargets; ++target) {
    const std::vector<float> terms = test::wild_terms(random);
    data.sums.push_back(test::rounded_sum(terms));
    data.x.insert(data.x.end(), terms.begin(), terms.end());
    data.index.insert(data.index.end(), terms.size(), target);
  }
  // A run keeps its sizes: the rest names no place.
  constexpr size_t kTerms = 24000;
  REQUIRE(data.x.size() <= kTerms);
  data.x.resize(kTerms, 1e30F);
  data.index.resize(kTerms, 2 * kTargets);
  return shuffled(std::move(data), random);
}

std::vector<uint32_t> bits(const Array& array) {
  std::vector<uint32_t> out;
  for (const double x : array.to_doubles()) out.push_back(std::bit_cast<uint32_t>(static_cast<float>(x)));
  return out;
}

void require_same(const std::vector<uint32_t>& sums, const std::vector<uint32_t>& expected) {
  REQUIRE(sums.size() == expected.size());
  for (size_t k = 0; k < sums.size(); ++k) {
    INFO("sum " << k);
    REQUIRE(sums[k] == expected[k]);
  }
}

void bind(runtime::Program& program, const Data& data) {
  must(program.bind("index", Array::from_ints(data.index)));
  must(program.bind("x", Array::from_floats(data.x)));
}

void check(runtime::Program& program, const Data& data) {
  bind(program, data);
  std::vector<float> minus_x = data.x;  // the device's own negation may lose subnormals
  for (float& x : minus_x) x = -x;
  must(program.bind("minus_x", Array::from_floats(minus_x)));
  must(program.run("run"));
  require_same(bits(must(program.output("run", "plain"))), data.sums);
  const std::vector<uint32_t> pairs = bits(must(program.output("run", "pairs")));
  for (size_t k = 0; k < kTargets; ++k) {
    REQUIRE(pairs[2 * k] == data.sums[k]);
    REQUIRE(pairs[2 * k + 1] == (data.sums[k] == 0 ? 0 : data.sums[k] ^ 0x80000000U));
  }
  must(program.run("move", 2));
  require_same(bits(must(program.output("move", "moving"))), data.sums);
  must(program.run("hold", 2));
  require_same(bits(must(program.leaf("held"))), data.sums);
}

}  // namespace

TEST_CASE("sums of few elements are rounded once in every order and on every road") {
  const auto path = (std::filesystem::path(DR_BUILD_DIR) / "few_sums_test.dr").string();
  std::ofstream(path) << kText;
  std::mt19937 random(5);
  std::vector<Data> sets;
  for (int k = 0; k < 100; ++k) sets.push_back(made(random));
  for (const auto& [name, device] : test::devices()) {
    const std::vector<Road> all = roads(name);
    for (size_t r = 0; r < all.size(); ++r) {
      INFO(name << ", " << all[r].name << ", " << all[r].scatter);
      auto program = must(runtime::Program::load(device, test::compile(path, all[r].profile, all[r].scatter)));
      const size_t count = r == 0 ? sets.size() : 5;  // each road takes the same way for all
      for (size_t k = 0; k < count; ++k) {
        check(program, sets[k]);
        if (k < 5) check(program, shuffled(sets[k], random));
      }
    }
  }
}

TEST_CASE("sums of few elements are IEEE's where something is not finite, and otherwise overflow only when rounded") {
  const auto path = (std::filesystem::path(DR_BUILD_DIR) / "few_specials_test.dr").string();
  std::ofstream(path) << "edition 1;\ninput index : int[S];\ninput x : float[S];\n"
                         "step run { output sums = scatter_add(index, x, 40); }\n";
  constexpr float kInf = INFINITY, kMost = 0x1.fffffep127F, kLeast = 0x1p-149F;
  const std::pair<std::vector<float>, float> cases[] = {
      {{}, 0},
      {{kInf, 1, -3e38F}, kInf},
      {{-kInf, -kInf, kMost}, -kInf},
      {{kInf, -kInf}, NAN},
      {{NAN, 1}, NAN},
      {{NAN, kInf}, NAN},
      {{kInf, kMost, kMost}, kInf},
      {{kMost, kMost}, kInf},
      {{kMost, kMost, -kMost}, kMost},
      {{-kMost, -kMost, -kMost, kMost}, -kInf},
      {{kMost, 0x1p103F}, kInf},
      {{kMost, 0x1.fffffep102F}, kMost},
      {{-kMost, -0x1p103F}, -kInf},
      {{kMost, 0x1p103F, -kLeast}, kMost},
      {{-0.0F}, 0},
      {{-0.0F, -0.0F}, 0},
      {{1, -1}, 0},
      {{kLeast, kLeast, kLeast}, 3 * kLeast},
      {{-kLeast}, -kLeast},
      {{0x1p-126F, -kLeast}, 0x1p-126F - kLeast},
      {{0x1p-127F, 0x1p-127F}, 0x1p-126F},
      {{1, kLeast}, 1},
      {{1, 0x1p-24F}, 1},
      {{1, 0x1p-24F, kLeast}, 1 + 0x1p-23F},
      {{1 + 0x1p-23F, 0x1p-24F}, 1 + 0x1p-22F},
      {{1, kMost, kLeast, -kMost, 0x1p-24F}, 1 + 0x1p-23F},
  };
  Data data;
  for (size_t k = 0; k < std::size(cases); ++k)
    for (const float x : cases[k].first) {
      data.index.push_back(static_cast<int32_t>(k));
      data.x.push_back(x);
    }
  std::mt19937 random(3);
  for (const auto& [name, device] : test::devices())
    for (const Road& road : roads(name)) {
      auto program = must(runtime::Program::load(device, test::compile(path, road.profile, road.scatter)));
      for (int order = 0; order < 3; ++order) {
        data = shuffled(data, random);
        bind(program, data);
        must(program.run("run"));
        const std::vector<double> sums = must(program.output("run", "sums")).to_doubles();
        for (size_t k = 0; k < std::size(cases); ++k) {
          INFO(name << ", " << road.name << ", case " << k);
          const auto sum = static_cast<float>(sums[k]);
          const float expected = cases[k].second;
          CHECK(std::isnan(sum) == std::isnan(expected));
          if (!std::isnan(expected)) CHECK(std::bit_cast<uint32_t>(sum) == std::bit_cast<uint32_t>(expected));
        }
      }
    }
}

// One pass adds to few elements and to as many as data says; few of its elements add anything.
TEST_CASE("sums of few elements stand beside those of many in one pass") {
  const auto path = (std::filesystem::path(DR_BUILD_DIR) / "few_and_many_test.dr").string();
  std::ofstream(path) << R"(edition 1;
input index : ivec2[S];
input x : vec2[S];
param few : vec2[30] = vec2(1.5);
param lone : float[20] = 0.5;
param many : float[T] = 1.0;
fn pick(i: ivec2) -> float { few.at(i.x % 30).x * many.at(i.y) + few.at(i.y % 30).y }
let read = if x.y > 0.8 { x.x * pick(index) } else { 0.0 };
let alone = if x.y > 0.5 { sin(x.x) * lone.at(index.x % 20) } else { 0.0 };
let all = grad(sum(read * read), few);
let share = grad(sum(read * read), many);
let one = grad(sum(alone * alone), lone);
step run { few <- few - 0.01 * all; many <- many - 0.01 * share; lone <- lone - 0.01 * one; output all, share, one; }
)";
  constexpr size_t kSources = 20000;
  std::mt19937 random(9);
  std::vector<int32_t> index(2 * kSources);
  std::vector<float> x(2 * kSources);
  for (int32_t& i : index) i = static_cast<int32_t>(random() % kTargets);
  for (float& y : x) y = std::uniform_real_distribution<float>(0, 1)(random);
  const char* const outputs[] = {"all", "share", "one"};
  const auto run = [&](auto& program) {
    must(program.bind("index", Array::from_ints(index, 2)));
    must(program.bind("x", Array::from_floats(x, 2)));
    must(program.bind("many", Array::from_floats(std::vector<float>(kTargets, 1.0F))));
    must(program.run("run", 2));
    std::vector<Array> out;
    for (const char* output : outputs) out.push_back(must(program.output("run", output)));
    return out;
  };
  auto reference = must(jit::ReferenceProgram::load(test::compile(path, "lavapipe", "auto")));
  const std::vector<Array> truth = run(reference);
  std::vector<Array> first;
  for (const auto& [name, device] : test::devices())
    for (const Road& road : roads(name))
      for (const bool listed : {true, false}) {
        if (road.scatter == "rows") continue;
        INFO(name << ", " << road.name << (listed ? ", listed" : ", all"));
        jit::Options options;
        options.profile = road.profile, options.scatter = road.scatter;
        if (!listed) options.ablate = {"active"};
        auto program = must(runtime::Program::load(device, test::compile(path, options)));
        const std::vector<Array> sums = run(program);
        if (first.empty()) first = sums;
        for (size_t o = 0; o < std::size(outputs); ++o) {
          INFO(outputs[o]);
          const auto is = sums[o].to_doubles(), should = truth[o].to_doubles();
          double difference = 0, size = 0;
          for (size_t k = 0; k < is.size(); ++k)
            difference += (is[k] - should[k]) * (is[k] - should[k]), size += should[k] * should[k];
          CHECK(difference <= 1e-12 * size);
          CHECK(sums[o].bytes == first[o].bytes);
        }
      }
}
