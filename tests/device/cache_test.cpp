// SPDX-License-Identifier: Apache-2.0
// The reactive cache changes nothing but the work: random programs under random sequences of bindings and steps give
// the same bits without it, with it, and with rebuilding for the leaves that move; and the counters add up.
// DR_CACHE_PROGRAMS sets how many programs run on each device.
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <random>
#include <set>
#include <thread>

#include "compiler/backend/compile.h"
#include "compiler/passes/passes.h"
#include "runtime/jit/jit.h"
#include "runtime/jit/rebuild.h"
#include "runtime/runtime.h"
#include "tests/catch.h"
#include "tests/device/compile.h"
#include "tests/device/devices.h"
#include "tests/unit/passes/random_graph.h"

using namespace dr;
using io::Array;
using runtime::Program;
using test::must;

namespace {

// The graph with two or three steps, which update some of its leaves and output some of its values.
ir::Graph with_steps(ir::Graph graph, std::mt19937_64& random) {
  const std::vector<ir::Output> outputs = graph.steps[0].outputs;
  std::vector<ir::ValueId> values;
  for (const ir::OpId id : graph.region(graph.root()).ops)
    for (const ir::ValueId v : graph.op(id).results) values.push_back(v);
  graph.steps.clear();
  for (uint64_t s = 0, n = 2 + random() % 2; s < n; ++s) {
    ir::Step step{"step" + std::to_string(s), {}, {}};
    for (const ir::Output& o : outputs)
      if (step.outputs.empty() || random() % 2 == 0) step.outputs.push_back(o);
    for (uint32_t leaf = 0; leaf < graph.leaves.size(); ++leaf) {
      if (random() % 3 != 0) continue;
      std::vector<ir::ValueId> fitting;
      for (const ir::ValueId v : values)
        if (graph.value(v).type == graph.leaves[leaf].type && graph.value(v).extent == graph.leaves[leaf].extent)
          fitting.push_back(v);
      if (fitting.empty()) continue;
      step.updates.push_back({leaf, fitting[random() % fitting.size()]});
      graph.leaves[leaf].kind = ir::Leaf::Kind::Param;
    }
    graph.steps.push_back(std::move(step));
  }
  return graph;
}

Array random_data(const ir::Leaf& leaf, std::mt19937_64& random) {
  const auto axis = [](const ir::Dim& d) { return *d.evaluate({}); };
  const int64_t w = axis(leaf.extent.w), h = axis(leaf.extent.h), l = axis(leaf.extent.l);
  std::vector<double> values(static_cast<size_t>(w * h * l * leaf.type.components()));
  for (double& v : values)
    v = leaf.type.is_bool() ? static_cast<double>(random() % 2) : static_cast<double>(random() % 7) - 2;
  return Array::from_doubles(values, leaf.type.components(), w, h, l);
}

std::vector<uint8_t> compile(const ir::Graph& graph, const std::string& profile,
                             const backend::CompileOptions& options) {
  auto loaded = target::load_profile(profile);
  auto compiled = backend::compile(graph, std::get<target::Profile>(loaded), options);
  if (const auto* problem = std::get_if<backend::Limit>(&compiled)) FAIL(problem->text);
  return bundle::write(std::get<backend::Compiled>(compiled).bundle);
}

void check_same(Program& a, Program& b, const std::string& step) {
  for (const std::string& name : a.outputs(step)) {
    INFO("output " << name << " of " << step);
    CHECK(must(a.output(step, name)).bytes == must(b.output(step, name)).bytes);
  }
  for (const auto& leaf : a.leaves()) {
    INFO("leaf " << leaf.name);
    CHECK(must(a.leaf(leaf.name)).bytes == must(b.leaf(leaf.name)).bytes);
  }
}

std::vector<uint8_t> compile_text(const std::string& text, const std::string& profile) {
  return test::compile_text("cache_test.dr", "edition 1;\n" + text, profile);
}

double number(Program& program, const std::string& step, const std::string& name) {
  return must(program.output(step, name)).to_doubles()[0];
}

// Commands that the next run of the step leaves out.
int64_t skipped(Program& program, const std::string& step, int times = 1) {
  const int64_t before = program.counters(step).skipped.commands;
  must(program.run(step, times));
  return program.counters(step).skipped.commands - before;
}

struct Totals {
  runtime::Work run, skipped;
  int rebuilds = 0;
};

void check_random_program(const test::NamedDevice& device, uint64_t seed, Totals& totals) {
  INFO("program " << seed << " on " << device.name);
  std::mt19937_64 random(seed);
  ir::Graph graph = with_steps(passes_test::random_graph(seed), random);
  if (seed % 2 == 0) graph = passes::run_passes(graph, passes::default_passes(), {});
  backend::CompileOptions options;
  options.lower = seed % 3 == 0 ? backend::Lower::Fragment : backend::Lower::Compute;
  jit::Options anew;
  if (seed % 5 == 0) {
    options.fused = options.recompute = options.stages = false;
  } else if (seed % 2 == 1) {
    options.recompute = false;
    anew.ablate = {"remat"};
  }
  const std::vector<uint8_t> bundle = compile(graph, device.name, options);
  runtime::LoadOptions rebuilding{.rebuild = jit::rebuilder(bundle, anew), .rebuild_after = 2, .rebuild_beside = false};
  Program with = must(Program::load(device.device, bundle)),
          rebuilt = must(Program::load(device.device, bundle, rebuilding)),
          without = must(Program::load(device.device, bundle, {.cache = false}));
  const auto bind = [&](const ir::Leaf& leaf) {
    const Array data = random_data(leaf, random);
    for (Program* p : {&with, &rebuilt, &without}) must(p->bind(leaf.name, data));
  };
  std::set<std::string> ran;
  const auto run = [&](const std::string& step, int times) {
    for (Program* p : {&with, &rebuilt, &without}) must(p->run(step, times));
    ran.insert(step);
    for (const std::string& any : ran) {
      check_same(with, without, any);
      check_same(rebuilt, without, any);
    }
  };
  for (const ir::Leaf& leaf : graph.leaves) bind(leaf);
  for (int action = 0; action < 12; ++action) {
    const std::string step = graph.steps[random() % graph.steps.size()].name;
    const ir::Leaf& leaf = graph.leaves[random() % graph.leaves.size()];
    switch (random() % 4) {
      case 0: bind(leaf); break;
      case 1:  // what a rebuild waits for
        for (int k = 0; k < 4; ++k) {
          bind(leaf);
          run(step, 1);
        }
        break;
      default: run(step, 1 + static_cast<int>(random() % 3));
    }
  }
  totals.rebuilds += rebuilt.rebuilds();
  for (const std::string& step : ran) {
    const auto a = with.counters(step), b = without.counters(step);
    CHECK(a.runs == b.runs);
    CHECK(b.skipped.commands == 0);
    CHECK(a.run.commands + a.skipped.commands == b.run.commands);
    CHECK(a.run.ops + a.skipped.ops == b.run.ops);
    CHECK(a.run.bytes + a.skipped.bytes == b.run.bytes);
    totals.run += a.run;
    totals.skipped += a.skipped;
  }
}

}  // namespace

TEST_CASE("random programs give the same bits with and without the cache") {
  const char* wanted = std::getenv("DR_CACHE_PROGRAMS");
  for (const test::NamedDevice& device : test::devices()) {
    // SwiftShader takes ten times as long to compile.
    const uint64_t programs = wanted ? std::strtoull(wanted, nullptr, 10) : device.name == "lavapipe" ? 24 : 6;
    Totals totals;
    for (uint64_t seed = 1; seed <= programs; ++seed) check_random_program(device, seed, totals);
    for (const std::string& message : device.device.validation_messages()) FAIL("validation: " << message);
    const long long commands = totals.run.commands + totals.skipped.commands;
    const double share = static_cast<double>(totals.skipped.commands) / static_cast<double>(commands);
    std::printf("%-12s %llu programs, %.0f%% of %lld commands left out; %d rebuilds\n", device.name.c_str(),
                static_cast<unsigned long long>(programs), 100 * share, commands, totals.rebuilds);
    if (programs >= 24) CHECK(totals.rebuilds > 0);
    CHECK(share > 0.2);
    CHECK(share < 0.9);
  }
}

TEST_CASE("what did not change is not computed again, and what did is at once") {
  // `slow` is a reduction of its own; both steps use it, and `shape` changes it.
  const char* const text = R"(
    input photo : float[W, H];
    param albedo : float = 1.0;
    param shape : float = 2.0;
    let slow = sum(photo * shape);
    step paint { albedo <- albedo + slow; output albedo, slow, index = step_index; }
    step carve { shape <- shape + 1.0; output slow; }
    step look { output slow, twice = sum(photo) * 2.0; })";
  for (const auto& [name, device] : test::devices()) {
    INFO(name);
    Program p = must(Program::load(device, compile_text(text, name)));
    must(p.bind("photo", Array::from_floats(std::vector<float>(12, 1.0f), 1, 4, 3)));
    CHECK(skipped(p, "paint") == 0);
    CHECK(number(p, "paint", "slow") == 24);
    const int64_t all = must(p.command_count("paint"));
    const int64_t kept = skipped(p, "paint");
    CHECK(kept > 0);
    CHECK(kept < all);
    CHECK(skipped(p, "paint", 5) == 5 * kept);
    CHECK(number(p, "paint", "albedo") == 1 + 24 * 6);  // before the last update
    CHECK(number(p, "paint", "index") == 6);
    // The other step changes what `slow` depends on: its own are steady, and the first one's are dirty again.
    must(p.run("carve", 2));
    CHECK(number(p, "carve", "slow") == 36);
    CHECK(skipped(p, "paint") == 0);
    CHECK(number(p, "paint", "slow") == 48);
    CHECK(skipped(p, "paint") == kept);
    // A leaf that is bound anew, with the same data or other data.
    must(p.bind("photo", Array::from_floats(std::vector<float>(12, 0.5f), 1, 4, 3)));
    CHECK(skipped(p, "paint") == 0);
    CHECK(number(p, "paint", "slow") == 24);
    must(p.bind("albedo", Array::from_floats(std::vector<float>{7}, 1)));
    CHECK(skipped(p, "paint") == kept);
    CHECK(number(p, "paint", "albedo") == 7);
    // A step that changes nothing runs nothing the second time.
    CHECK(skipped(p, "look") == 0);
    CHECK(number(p, "look", "twice") == 12);
    CHECK(skipped(p, "look") == must(p.command_count("look")));
    CHECK(number(p, "look", "twice") == 12);
    must(p.run("carve"));
    CHECK(skipped(p, "look") > 0);
    CHECK(number(p, "look", "slow") == 30);
    for (const std::string& message : device.validation_messages()) FAIL("validation: " << message);
  }
}

TEST_CASE("a program is built anew for the leaves that move, and for others again") {
  // `seen` takes `slow` and the view in one pass: a new view costs `slow` again, until they stand apart.
  const char* const text = R"(
    input photo : float[W, H];
    input view : float;
    param tone : float = 1.0;
    let slow = sin(exp(sin(photo) * 0.5) + cos(photo)) * exp(cos(photo * 3.0));
    let seen = sin(slow * view);
    let error = mean(seen + shift(seen, 1, 0)) * tone;
    step fit { tone <- tone - 0.1 * grad(error, tone); output error, index = step_index; }
    step look { output sum = sum(slow) + tone; })";
  for (const auto& [name, device] : test::devices()) {
    INFO(name);
    const std::vector<uint8_t> bundle = compile_text(text, name);
    // In the background: as long as it takes. At once: after eight runs.
    for (const bool beside : {true, false}) {
      Program p = must(Program::load(device, bundle, {.rebuild = jit::rebuilder(bundle), .rebuild_beside = beside})),
              plain = must(Program::load(device, bundle, {.cache = false}));
      const auto photo = [](const std::vector<float>& values) { return Array::from_floats(values, 1, 3, 2); };
      int view = 0;
      const auto bind = [&](const char* leaf, const Array& data) {
        must(p.bind(leaf, data));
        must(plain.bind(leaf, data));
      };
      const auto run = [&](const std::string& step) {
        must(p.run(step));
        must(plain.run(step));
        check_same(p, plain, "fit");
        check_same(p, plain, "look");
      };
      const auto move = [&] {
        bind("view", Array::from_floats(std::vector<float>{0.1f * static_cast<float>(++view)}, 1));
        const int64_t before = p.counters("fit").run.ops;
        run("fit");
        return p.counters("fit").run.ops - before;
      };
      bind("photo", photo({0.1f, 0.7f, 0.2f, 0.9f, 0.3f, 0.5f}));
      bind("view", Array::from_floats(std::vector<float>{0}, 1));
      must(p.run("fit"));
      must(plain.run("fit"));
      must(p.run("look"));
      must(plain.run("look"));
      const int64_t ops = move();
      for (int k = 0; k < (beside ? 2000 : 8) && p.rebuilds() == 0; ++k) {
        CHECK(move() <= ops);
        if (beside && k > 8) std::this_thread::sleep_for(std::chrono::milliseconds(20));
      }
      CHECK(p.rebuilds() == 1);
      for (const runtime::CommandTime& t : must(p.timed_run("fit")))
        if (t.ops > 0) CHECK(!t.lines.empty());
      must(plain.run("fit"));
      const int64_t less = move();
      CHECK(less < ops);
      // What stood still moves: all at once, and no longer.
      bind("photo", photo({0.4f, 0.7f, 0.2f, 0.9f, 0.1f, 0.5f}));
      CHECK(move() > less);
      CHECK(move() == less);
      run("look");
      // Nothing moves any more.
      for (int k = 0; k < 20; ++k) run("fit");
      std::printf("%-12s ops of a run with a new view: %lld, apart %lld\n", name.c_str(), static_cast<long long>(ops),
                  static_cast<long long>(less));
    }
    for (const std::string& message : device.validation_messages()) FAIL("validation: " << message);
  }
}

TEST_CASE("the counter of a step can be set") {
  for (const auto& [name, device] : test::devices()) {
    INFO(name);
    Program p = must(Program::load(device, compile_text("step go { output index = step_index; }", name)));
    must(p.set_runs("go", 41));
    must(p.run("go"));
    CHECK(number(p, "go", "index") == 41);
    must(p.run("go"));
    CHECK(number(p, "go", "index") == 42);
    must(p.set_runs("go", 3));
    must(p.run("go", 2));
    CHECK(number(p, "go", "index") == 4);
    must(p.set_runs("go", 5));  // as it is
    must(p.run("go"));
    CHECK(number(p, "go", "index") == 5);
    CHECK_FALSE(p.set_runs("go", -1));
  }
}

TEST_CASE("outputs that the host wrote to are made again by every step") {
  const char* const text = R"(
    input x : float;
    step one { output w = 3.0 * x, x_ = x; }
    step other { output v = 2.0 * x; })";
  for (const auto& [name, device] : test::devices()) {
    INFO(name);
    Program p = must(Program::load(device, compile_text(text, name)));
    const double one[] = {1.0};
    must(p.bind("x", Array::from_doubles(one, 1, 1, 1, 1)));
    for (const char* const step : {"one", "other", "one", "other"}) must(p.run(step));
    if (auto view = must(p.output_view("one", "w"))) *static_cast<float*>(view->data) = 7.0f;
    CHECK_FALSE(must(p.output_view("one", "x_")));  // it is the leaf
    must(p.run("other"));
    must(p.run("one"));
    CHECK(number(p, "one", "w") == 3);
    CHECK(number(p, "other", "v") == 2);
  }
}

TEST_CASE("tables of a topology follow faces that are bound again") {
  const char* const text = R"(
    input face : ivec3[F];
    let t = topology(face, 4);
    step go { output start = t.vertex_start; })";
  for (const auto& [name, device] : test::devices()) {
    INFO(name);
    Program p = must(Program::load(device, compile_text(text, name)));
    const auto starts = [&](std::vector<int32_t> corners) {
      must(p.bind("face", Array::from_ints(corners, 3, 2)));
      must(p.run("go"));
      return must(p.output("go", "start")).to_doubles();
    };
    CHECK(starts({0, 1, 2, 0, 2, 3}) == std::vector<double>{0, 2, 3, 5, 6});
    CHECK(starts({0, 1, 2, 1, 2, 3}) == std::vector<double>{0, 1, 3, 5, 6});
  }
}
