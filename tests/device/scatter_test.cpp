// SPDX-License-Identifier: Apache-2.0
// Every lowering of scatter_add on every device against the float64 evaluator, on what breaks sums: a target with most
// of the sources, magnitudes far apart, terms that cancel, empty targets, indices out of range, NaN and Inf. How many
// targets there are is known when data is bound: few_sums_test.cpp has sums of few elements.
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <random>

#include "compiler/backend/bundle/bundle.h"
#include "compiler/target/profile.h"
#include "runtime/jit/jit.h"
#include "runtime/jit/reference_program.h"
#include "runtime/runtime.h"
#include "tests/catch.h"
#include "tests/device/compile.h"
#include "tests/device/devices.h"
#include "tests/device/scatters.h"

using namespace dr;
using io::Array;
using test::compile;
using test::Data;
using test::data_sets;
using test::distance;
using test::must;
using test::narrow;
using test::same_bits;
using test::written;

namespace {

constexpr double kTolerance = 1e-6;  // relative L2
constexpr int kTargets = 300;

// `layers` sums each layer apart, `flat` all of them; `moving` has an index that no table can
// hold, under a condition; of `listed` only elements with a weight add something.
const char* const kText = R"(edition 1;
input index : ivec2[S];
input x : vec2[S];
let both = scatter_add(index.x, x, T) + scatter_add(index.y, x.yx, T);
let one = scatter_add(index.y, 0.5 * x.x, T);
let count = scatter_add(index.x, 1, T) + scatter_add(index.y, 2, T);
let wide = float(coord(S, 1, 3).z + 1) * x.x;
let layers = scatter_add(index.x, wide, T, 1, 3);
let flat = scatter_add(index.x, wide, T);
fn pick(a: vec2[T], i: ivec2) -> float { if i.x > 2 { a.at(i.x).x } else { a.at(i.y).y + a.at(i.x).x } }
param at : vec2[T] = vec2(1.0);
let moving = sum(x.x * pick(at, index));
let weight = if x.y > 0.5 { x.x } else { 0.0 };
let listed = sum(weight * pick(at, index));
step run { output both, one, count, layers, flat, moving = grad(moving, at), listed = grad(listed, at); }
)";
const char* const kOutputs[] = {"both", "one", "count", "layers", "flat", "moving", "listed"};

template <class P>
std::vector<Array> run(P& program, const Data& data) {
  must(program.bind("index", Array::from_ints(data.index, 2)));
  must(program.bind("x", Array::from_floats(data.x, 2)));
  must(program.bind("at", Array::from_floats(std::vector<float>(2 * kTargets, 1.0F), 2)));
  must(program.run("run"));
  std::vector<Array> out;
  for (const char* name : kOutputs) out.push_back(must(program.output("run", name)));
  return out;
}

}  // namespace

TEST_CASE("every lowering of scatter_add sums what breaks sums") {
  const auto path = (std::filesystem::path(DR_BUILD_DIR) / "scatter_test.dr").string();
  std::ofstream(path) << kText;
  const auto sets = data_sets();
  std::vector<std::vector<Array>> truths;
  for (const Data& data : sets) {
    auto reference = must(jit::ReferenceProgram::load(compile(path, "lavapipe", "auto")));
    truths.push_back(run(reference, data));
  }
  struct Lowering {
    std::string profile, scatter;
  };
  for (const auto& [name, device] : test::devices()) {
    std::vector<Lowering> lowerings{{narrow(), "exact"}, {narrow(), "rows"}, {narrow(), "auto"}};
    if (name == "lavapipe") lowerings.insert(lowerings.end(), {{"lavapipe", "exact"}, {"lavapipe", "rows"}});
    std::vector<std::vector<Array>> exact;
    for (const auto& [profile, scatter] : lowerings) {
      const auto bundle = compile(path, profile, scatter);
      for (size_t k = 0; k < sets.size(); ++k) {
        INFO(name << ", profile " << profile << ", " << scatter << ": " << sets[k].name);
        auto program = must(runtime::Program::load(device, bundle));
        const auto first = run(program, sets[k]);
        for (size_t o = 0; o < first.size(); ++o) {
          INFO(kOutputs[o]);
          CHECK(distance(first[o], truths[k][o]) <= kTolerance);
        }
        for (int again = 0; again < 3; ++again) {
          must(program.run("run"));
          for (size_t o = 0; o < first.size(); ++o)
            CHECK(must(program.output("run", kOutputs[o])).bytes == first[o].bytes);
        }
        if (std::string_view(scatter) != "exact") continue;
        if (exact.size() <= k) exact.push_back(first);
        CHECK(same_bits(first, exact[k]));  // 64-bit words or two of 32 bits
      }
    }
  }
}

// A built-in profile as of a GPU with dear atomics, on which lanes join what they add.
std::string joining(const std::string& profile) {
  auto p = std::get<target::Profile>(target::load_profile(profile));
  p.subgroup_arithmetic = true;
  p.costs.atomic_add_ns = 1000;
  p.costs.compute_operations_per_ns = 1000;
  return written(p, "joining");
}

TEST_CASE("lanes that join what they add give the same bits") {
  const auto path = (std::filesystem::path(DR_BUILD_DIR) / "scatter_joined_test.dr").string();
  std::ofstream(path) << kText;
  auto sets = data_sets();
  sets.erase(sets.begin() + 5);  // few are enough: most of the time goes to pipelines
  sets.erase(sets.begin() + 2, sets.begin() + 4);
  Data& crowd = sets[0];  // most lanes add to one element, then runs of lanes, then whoever
  crowd.index.resize(2 * 20000);
  crowd.x.resize(2 * 20000);
  for (size_t k = 5000; k < crowd.index.size(); ++k)
    crowd.index[k] = static_cast<int32_t>(k < 20000 ? k / 6 % 300 : k * 7919 % 300);
  for (const auto& [name, device] : test::devices()) {
    // By a sum over all lanes that share an element, and, where lanes are in turn, by runs of lanes.
    std::vector<std::pair<std::string, std::string>> profiles{{narrow(), joining(narrow())}};
    if (name == "lavapipe") {
      auto alone = std::get<target::Profile>(target::load_profile("lavapipe"));
      alone.subgroup_shuffle = false;
      profiles.emplace_back(written(alone, "alone"), joining("lavapipe"));
      profiles.emplace_back(profiles.back().first, "lavapipe");
    }
    for (const auto& [profile, joins] : profiles) {
      const auto apart = compile(path, profile, "exact"), joined = compile(path, joins, "exact");
      const auto needs = [](const std::vector<uint8_t>& bytes) {
        const auto features = std::get<bundle::BundleT>(bundle::read(bytes)).features;
        return std::find(features.begin(), features.end(), bundle::Feature::SubgroupArithmetic) != features.end();
      };
      CHECK_FALSE(needs(apart));
      CHECK(needs(joined));
      for (const Data& data : sets) {
        INFO(name << ", profile " << joins << ": " << data.name);
        auto one = must(runtime::Program::load(device, apart)), other = must(runtime::Program::load(device, joined));
        CHECK(same_bits(run(one, data), run(other, data)));
      }
    }
  }
}

TEST_CASE("one dispatch clears what is needed together") {
  const auto path = (std::filesystem::path(DR_BUILD_DIR) / "scatter_cleared_test.dr").string();
  std::ofstream(path) << R"(edition 1;
input index : ivec2[S];
input x : vec2[S];
param tone : vec2[T] = vec2(1.0);
let first = scatter_add(index.x, x, T);
let second = scatter_add(index.y, x.x, T);
let largest = scatter_max(index.x, index.y, T);
let moving = scatter_add(index.x, x * tone.at(index.y), T);
let folded = scatter_add(index.y, x.y * moving.at(index.x).x, T);
step run { tone <- tone - 1e-3 * moving; output first, second, largest, moving, folded; }
)";
  auto gpu = std::get<target::Profile>(target::load_profile(narrow()));
  gpu.subgroup_size = 32;
  const auto by_fills = compile(path, narrow(), "exact"), by_dispatch = compile(path, written(gpu, "wide"), "exact");
  const auto clears = [](const std::vector<uint8_t>& bytes, bundle::CommandKind kind) {
    const auto bundle = std::get<bundle::BundleT>(bundle::read(bytes));
    return std::ranges::count_if(bundle.steps[0]->commands,
                                 [&](const auto& c) { return c->kind == kind && c->label.starts_with("clear "); });
  };
  CHECK(clears(by_fills, bundle::CommandKind::Fill) == 5);
  CHECK(clears(by_fills, bundle::CommandKind::Dispatch) == 0);
  // Of every run, and of those after a leaf was bound anew: `largest` does not depend on `x`.
  // Those that wait for the run before stay apart from those that need not.
  CHECK(clears(by_dispatch, bundle::CommandKind::Fill) == 0);
  CHECK(clears(by_dispatch, bundle::CommandKind::Dispatch) == 4);
  Data data = data_sets()[1];
  for (const auto& [name, device] : test::devices()) {
    auto one = must(runtime::Program::load(device, by_fills)),
         other = must(runtime::Program::load(device, by_dispatch));
    for (int bound = 0; bound < 3; ++bound) {
      INFO(name << ", binding " << bound);
      std::ranges::reverse(data.index);
      for (auto* program : {&one, &other}) {
        must(program->bind("index", Array::from_ints(data.index, 2)));
        must(program->bind("x", Array::from_floats(data.x, 2)));
        must(program->bind("tone", Array::from_floats(std::vector<float>(2 * kTargets, 1.0F), 2)));
      }
      for (int again = 0; again < 3; ++again) {
        must(one.run("run"));
        must(other.run("run"));
        for (const char* output : {"first", "second", "largest", "moving", "folded"}) {
          INFO(output);
          CHECK(must(one.output("run", output)).bytes == must(other.output("run", output)).bytes);
        }
      }
    }
  }
}

TEST_CASE("exact sums keep what few elements add, and compute again what finds no room") {
  const auto path = (std::filesystem::path(DR_BUILD_DIR) / "scatter_kept_test.dr").string();
  std::ofstream(path) << R"(edition 1;
param tone : float[T];
input where : float[S];
input weight : float[S];
fn pick(tone: float[T], x: float) -> float { sqrt(tone.at(int(x)) * tone.at(int(x) + 1)) }
let blend = if weight > 0.0 { pick(tone, where) } else { 0.0 };
let pull = grad(sum(blend * blend), tone);
step run { tone <- tone - 1e-3 * pull; output blend, pull; }
)";
  constexpr size_t kElements = 40000;
  std::mt19937 random(3);
  std::uniform_real_distribution<float> place(-10, 310), share(0, 1), tone(0.5F, 2);
  std::vector<float> where(kElements), tones(300);
  for (float& x : where) x = place(random);
  for (float& x : tones) x = tone(random);
  const auto pull = [&](auto& program, const std::vector<float>& weight) {
    must(program.bind("tone", Array::from_floats(tones)));
    must(program.bind("where", Array::from_floats(where)));
    must(program.bind("weight", Array::from_floats(weight)));
    must(program.run("run"));
    return must(program.output("run", "pull"));
  };
  for (const float active : {0.01F, 0.6F}) {  // of the elements; there is room for one in 32 and a thousand
    std::vector<float> weight(kElements);
    for (float& x : weight) x = share(random) < active ? share(random) : -1.0F;
    auto reference = must(jit::ReferenceProgram::load(test::compile(path, "lavapipe", "exact")));
    const Array truth = pull(reference, weight);
    for (const auto& [name, device] : test::devices()) {
      INFO(name << ", " << active << " of the elements");
      jit::Options all;
      all.profile = narrow(), all.scatter = "exact", all.ablate = {"active"};
      auto unlisted = must(runtime::Program::load(device, test::compile(path, all)));
      const Array expected = pull(unlisted, weight);
      CHECK(distance(expected, truth) <= kTolerance);
      for (const std::string& profile : {narrow(), joining(narrow())}) {
        jit::Options kept = all;
        kept.profile = profile, kept.ablate = {"guesses"};
        const auto bytes = test::compile(path, kept), guessed = test::compile(path, profile, "exact");
        const auto bundle = std::get<bundle::BundleT>(bundle::read(bytes));
        CHECK(std::ranges::any_of(bundle.resources, [](const auto& r) { return r->name.ends_with("_terms"); }));
        for (const auto& way : {bytes, guessed}) {
          auto program = must(runtime::Program::load(device, way));
          CHECK(pull(program, weight).bytes == expected.bytes);
        }
      }
    }
  }
}

// The largest contribution goes up and down by all sorts of factors, to zero, Inf and NaN, from run to run: what a run
// guessed leaves no trace.
TEST_CASE("exact sums are those of a first run, whatever the run before made them guess") {
  const auto path = (std::filesystem::path(DR_BUILD_DIR) / "scatter_guess_test.dr").string();
  std::ofstream(path) << R"(edition 1;
input index : ivec2[S];
input x : vec2[S];
input factor : float;
input few : int;
param runs : int = 0;
let one = float(1 + runs - runs);
let all = scatter_add(index.x, (factor * x + exp(sin(x)) * x / (0.3 + abs(x.yx))) * one, T);
let some = scatter_add(if coord(S).x < few { index.y } else { -1 }, factor * factor * x.y / 3.0 * one, T);
param tone : float[T] = 1.5;
fn pick(i: int) -> float { sqrt(tone.at(i) * tone.at(i + 1)) }
let blend = if x.x > 0.2 { factor * pick(index.x) * exp(-x.y) / (1.0 + x.x) } else { 0.0 };
let pull = grad(sum(blend * blend), tone);
step run { runs <- runs + 1; tone <- tone * one; output all, some, pull; }
)";
  const Data data = data_sets()[1];
  const auto bind = [&](auto& program) {
    must(program.bind("index", Array::from_ints(data.index, 2)));
    must(program.bind("x", Array::from_floats(data.x, 2)));
    must(program.bind("tone", Array::from_floats(std::vector<float>(kTargets, 1.5F))));
  };
  const auto once = [&](auto& program, float factor, int few) {
    must(program.bind("factor", Array::from_floats(std::span(&factor, 1))));
    must(program.bind("few", Array::from_ints(std::span(&few, 1))));
    must(program.run("run"));
    return std::vector<Array>{must(program.output("run", "all")), must(program.output("run", "some")),
                              must(program.output("run", "pull"))};
  };
  auto gpu = std::get<target::Profile>(target::load_profile(narrow()));
  gpu.subgroup_size = 32;
  const std::string alone = written(gpu, "guessing");
  gpu.subgroup_arithmetic = true;
  for (const auto& [name, device] : test::devices())
    for (const std::string& profile : {alone, written(gpu, "guessing_joined")}) {
      const auto guessing = compile(path, profile, "exact");
      const auto bundle = std::get<bundle::BundleT>(bundle::read(guessing));
      CHECK(std::ranges::count(bundle.resources, bundle::Role::Guess, [](const auto& r) { return r->role; }) == 3);
      jit::Options plainly;
      plainly.profile = profile, plainly.scatter = "exact", plainly.ablate = {"guesses"};
      auto program = must(runtime::Program::load(device, guessing)),
           apart = must(runtime::Program::load(device, compile(path, plainly)));
      bind(program);
      bind(apart);
      for (const float factor : {1.0F, 1.0F, 3e4F, 1e-7F, 0.0F, 2.5F, 1e18F, -1.0F, INFINITY, 0.5F, NAN, 0.25F})
        for (const int few : {5000, 3}) {
          INFO(name << ", factor " << factor << ", " << few << " of the sources");
          auto fresh = must(runtime::Program::load(device, guessing));
          bind(fresh);
          const std::vector<Array> found = once(program, factor, few);
          CHECK(same_bits(found, once(fresh, factor, few)));
          CHECK(same_bits(found, once(apart, factor, few)));
        }
    }
}

// Sums that their reader leaves zeros: every run finds them so, whatever the one before added, Inf and NaN among it,
// and whatever way it ran.
TEST_CASE("sums that their reader empties are those of cleared memory") {
  const auto path = (std::filesystem::path(DR_BUILD_DIR) / "scatter_emptied_test.dr").string();
  std::ofstream(path) << R"(edition 1;
input index : ivec2[S];
input x : vec2[S];
input factor : float;
param tone : vec3[T] = vec3(1.5);
param few : float[F] = 0.5;
let read = tone.at(index.x) * factor * x.x + tone.at(index.y);
let pull = grad(sum(read * read) + sum(few.at(index.x % 7) * x.y), tone);
let share = grad(sum(few.at(index.x % 7) * few.at(index.y % 7) * x.y * factor), few);
step run { tone <- tone - 0.01 * pull; few <- few - 0.01 * share; }
)";
  const Data data = data_sets()[1];
  const std::vector<float> tone(900, 1.5F), few(7, 0.5F);
  const auto once = [&](auto& program, float factor, int way) {
    must(program.bind("index", Array::from_ints(data.index, 2)));
    must(program.bind("x", Array::from_floats(data.x, 2)));
    must(program.bind("tone", Array::from_floats(tone, 3)));
    must(program.bind("few", Array::from_floats(few)));
    must(program.bind("factor", Array::from_floats(std::span(&factor, 1))));
    if (way == 0) must(program.run("run", 3));
    if (way == 1) must(program.timed_run("run"));
    if (way == 2) must(program.checked_run("run"));
    return std::vector<Array>{must(program.leaf("tone")), must(program.leaf("few"))};
  };
  auto gpu = std::get<target::Profile>(target::load_profile(narrow()));
  gpu.subgroup_size = 32;
  const std::string plain = written(gpu, "emptied");
  for (const auto& [name, device] : test::devices()) {
    jit::Options options;
    options.profile = plain, options.scatter = "exact";
    const auto emptied = compile(path, options);
    const auto bundle = std::get<bundle::BundleT>(bundle::read(emptied));
    CHECK(std::ranges::count(bundle.resources, bundle::Role::Zeros, [](const auto& r) { return r->role; }) == 2);
    options.ablate = {"emptying"};
    auto program = must(runtime::Program::load(device, emptied)),
         cleared = must(runtime::Program::load(device, compile(path, options)));
    for (const float factor : {1.0F, 3e4F, INFINITY, 1e-7F, NAN, 0.0F, 2.5F, -1.0F})
      for (const int way : {0, 1, 2}) {
        INFO(name << ", factor " << factor << ", way " << way);
        CHECK(same_bits(once(program, factor, way), once(cleared, factor, way)));
      }
  }
}

// Sums that a scatter reads at listed elements alone are cleared there: every run finds them so, whichever elements the
// runs before listed, and whatever was added to the others, Inf and NaN among it.
TEST_CASE("sums that are cleared where elements are listed are those of cleared memory") {
  const auto path = (std::filesystem::path(DR_BUILD_DIR) / "scatter_listed_sums_test.dr").string();
  std::ofstream(path) << R"(edition 1;
param edge : vec2[V];
param shift : float = 0.0;
input at : float[P];
input scale : float[P];
input factor : float;
input each : int;
let p = coord(64, 64).y * 64 + coord(64, 64).x;
let first = (p + int(shift)) % edge.width;
let crossed = p % each == 0;
let covered = if crossed {
  fold(i in 0..2 + p % 2, s = vec2(1.0), max = 3) { s * edge.at((first + i) % edge.width) }
} else {
  vec2(1.0)
};
let q = int(at + shift);
let near = covered.at(ivec2(q % 64, q / 64));
let loss = sum(factor * scale * near.x * exp(near.y) * sqrt(covered.at(ivec2((q + 1) % 64, q / 64)).x + 2.0));
let pull = grad(loss, edge);
step run { edge <- edge - 0.01 * pull; shift <- shift + 1.0; output loss, pull; }
)";
  const auto bind = [&](auto& program) {
    std::mt19937 random(5);
    std::uniform_real_distribution<float> share(0.0F, 1.0F);
    std::vector<float> edge(2 * 97), at(3000), scale(3000);
    for (float& x : edge) x = 0.5F + share(random);
    for (float& x : at) x = std::floor(4000.0F * share(random));
    for (float& x : scale) x = share(random) - 0.5F;
    must(program.bind("edge", Array::from_floats(edge, 2)));
    must(program.bind("at", Array::from_floats(at)));
    must(program.bind("scale", Array::from_floats(scale)));
  };
  const auto once = [&](auto& program, float factor, int each) {
    must(program.bind("factor", Array::from_floats(std::span(&factor, 1))));
    must(program.bind("each", Array::from_ints(std::span(&each, 1))));
    must(program.run("run"));
    return std::vector<Array>{must(program.output("run", "loss")), must(program.output("run", "pull"))};
  };
  const auto words_cleared = [](const std::vector<uint8_t>& bytes) {
    const auto bundle = std::get<bundle::BundleT>(bundle::read(bytes));
    for (const auto& c : bundle.steps[0]->commands)
      if (c->kind == bundle::CommandKind::Fill && c->label == "clear scatter_add") return c->elements;
    FAIL("no such sums");
    return std::string();
  };
  auto in_turn = std::get<target::Profile>(target::load_profile(narrow()));
  in_turn.lanes_in_turn = true;
  for (const auto& [name, device] : test::devices())
    for (const std::string& profile : {written(in_turn, "in_turn"), std::string("lavapipe")}) {
      if (profile == "lavapipe" && name != "lavapipe") continue;
      jit::Options options;
      options.profile = profile, options.scatter = "exact";
      const auto listed = compile(path, options);
      CHECK(words_cleared(listed) == (profile == "lavapipe" ? "4" : "2"));
      options.ablate = {"emptying"};
      const auto whole = compile(path, options);
      CHECK(words_cleared(whole).empty());
      auto program = must(runtime::Program::load(device, listed)),
           cleared = must(runtime::Program::load(device, whole));
      auto reference = must(jit::ReferenceProgram::load(listed));
      bind(program);
      bind(cleared);
      bind(reference);
      // Inf and NaN stay in what is sought: what follows begins anew.
      for (const float factor : {1.0F, 3e4F, 1e-7F, 0.0F, 2.5F, INFINITY, 1.0F, NAN, 2.0F})
        for (const int each : {5, 3, 7}) {
          INFO(name << ", profile " << profile << ", factor " << factor << ", each " << each);
          if (factor == 1.0F || factor == 2.0F) {
            bind(program);
            bind(cleared);
            bind(reference);
          }
          const std::vector<Array> found = once(program, factor, each);
          CHECK(same_bits(found, once(cleared, factor, each)));
          const std::vector<Array> truth = once(reference, factor, each);
          if (factor == 1.0F) CHECK(distance(found[1], truth[1]) <= kTolerance);
        }
    }
}

// Listed elements with an adjoint of zero are left out before the first run: the sums are those of a scatter that runs
// for all elements, whichever adjoints are zero, and whatever the others are.
TEST_CASE("listed elements without an adjoint change no bit") {
  const auto path = (std::filesystem::path(DR_BUILD_DIR) / "scatter_nonzero_test.dr").string();
  std::ofstream(path) << R"(edition 1;
param edge : vec2[V];
param shift : float = 0.0;
input at : float[P];
input pull : vec2[P];
let p = coord(64, 64).y * 64 + coord(64, 64).x;
let first = (p + int(shift)) % edge.width;
let crossed = if p % 3 == 0 {
  reduce(sum, i in 0..40) { exp(sin(edge.at((first + i) % edge.width).x * float(i))) } > 40.0
} else {
  false
};
let covered = if crossed {
  fold(i in 0..2 + p % 2, s = vec2(0.0), max = 3) { s + sin(edge.at((first + i) % edge.width)).yx }
} else {
  vec2(1.0)
};
let q = int(at + shift);
let loss = sum(dot(pull, covered.at(ivec2(q % 64, q / 64))));
let to_edge = grad(loss, edge);
step run { shift <- shift + 1.0; edge <- edge + 0.0 * shift; output to_edge; }
)";
  std::mt19937 random(9);
  std::uniform_real_distribution<float> share(0.0F, 1.0F);
  std::vector<float> edge(2 * 97), at(2000), pull(2 * 2000);
  for (float& x : edge) x = 3.0F * share(random);
  for (float& x : at) x = std::floor(4000.0F * share(random));
  for (float& x : pull) x = share(random) - 0.5F;
  const auto once = [&](auto& program, float few, float factor) {
    std::vector<float> pulls(pull);
    for (size_t k = 0; k < pulls.size(); ++k) pulls[k] = pulls[k] > few ? 0.0F * pulls[k] : factor * pulls[k];
    must(program.bind("edge", Array::from_floats(edge, 2)));
    must(program.bind("at", Array::from_floats(at)));
    must(program.bind("pull", Array::from_floats(pulls, 2)));
    must(program.run("run"));
    return std::vector<Array>{must(program.output("run", "to_edge"))};
  };
  auto in_turn = std::get<target::Profile>(target::load_profile(narrow()));
  in_turn.lanes_in_turn = true;
  for (const auto& [name, device] : test::devices())
    for (const std::string& profile : {written(in_turn, "nonzero"), std::string("lavapipe")}) {
      if (profile == "lavapipe" && name != "lavapipe") continue;
      jit::Options options;
      options.profile = profile, options.scatter = "exact";
      const auto listed = compile(path, options);
      const auto bundle = std::get<bundle::BundleT>(bundle::read(listed));
      CHECK(
          std::ranges::any_of(bundle.steps[0]->commands, [](const auto& c) { return c->label.ends_with(" nonzero"); }));
      options.ablate = {"active"};
      auto program = must(runtime::Program::load(device, listed)),
           all = must(runtime::Program::load(device, compile(path, options)));
      auto reference = must(jit::ReferenceProgram::load(listed));
      for (const float few : {0.5F, -0.4F, -0.6F, 0.0F})
        for (const float factor : {1.0F, 1e25F, 1e-30F, INFINITY, NAN, -2.0F}) {
          INFO(name << ", profile " << profile << ", pulls up to " << few << ", factor " << factor);
          const std::vector<Array> found = once(program, few, factor);
          CHECK(same_bits(found, once(all, few, factor)));
          const std::vector<Array> truth = once(reference, few, factor);
          if (std::abs(factor) <= 2.0F && factor != 1e-30F) CHECK(distance(found[0], truth[0]) <= kTolerance);
        }
    }
}

TEST_CASE("rows follow an index that is bound anew") {
  const auto path = (std::filesystem::path(DR_BUILD_DIR) / "scatter_test.dr").string();
  const auto sets = data_sets();
  for (const auto& [name, device] : test::devices()) {
    INFO(name);
    auto program = must(runtime::Program::load(device, compile(path, narrow(), "rows")));
    Data data = sets[2];
    run(program, data);
    for (int32_t& i : data.index) i = 299 - i;
    const auto moved = run(program, data);
    auto reference = must(jit::ReferenceProgram::load(compile(path, "lavapipe", "auto")));
    const auto truth = run(reference, data);
    for (size_t o = 0; o < truth.size(); ++o) CHECK(distance(moved[o], truth[o]) <= kTolerance);
  }
}

// Sums of small integers are exact in any order.
TEST_CASE("float atomics add where the device has them") {
  const auto path = (std::filesystem::path(DR_BUILD_DIR) / "scatter_test.dr").string();
  std::mt19937 random(3);
  Data data{"integers", {}, {}};
  for (int k = 0; k < 4000; ++k) {
    data.index.push_back(static_cast<int32_t>(random() % 310) - 5);
    data.x.push_back(static_cast<float>(random() % 64) - 20.0f);
  }
  data.x[100] = NAN;
  data.x[2000] = INFINITY;
  // Where lanes branch, zeros are not added.
  auto branching = std::get<target::Profile>(target::load_profile("lavapipe"));
  branching.lanes_in_turn = false;
  const std::string profiles[] = {"lavapipe", written(branching, "branching")};
  auto reference = must(jit::ReferenceProgram::load(compile(path, "lavapipe", "auto")));
  const auto truth = run(reference, data);
  for (const auto& [name, device] : test::devices()) {
    INFO(name);
    if (name == "swiftshader") {
      const auto program = runtime::Program::load(device, compile(path, "lavapipe", "atomic"));
      REQUIRE(!program);
      CHECK(program.error().find("which the device lacks") != std::string::npos);
      continue;
    }
    for (const std::string& profile : profiles) {
      INFO(profile);
      auto loaded = must(runtime::Program::load(device, compile(path, profile, "atomic")));
      const auto sums = run(loaded, data);
      for (size_t o = 0; o < truth.size(); ++o) CHECK(distance(sums[o], truth[o]) == 0);
    }
  }
}
