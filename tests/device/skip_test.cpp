// SPDX-License-Identifier: Apache-2.0
// What is left out (docs/explain/skipping.md): for each a small program with the exact counts of what is done and
// avoided, with it and without it; the same bits either way; and, when what it depends on changes, the work that this
// asks for, with the bits of a program that never left anything out.
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>

#include "compiler/target/profile.h"
#include "runtime/jit/jit.h"
#include "runtime/runtime.h"
#include "tests/catch.h"
#include "tests/device/devices.h"
#include "tests/device/skip_cases.h"

using namespace dr;
using io::Array;
using runtime::Program;
using test::must;
using namespace skip_test;

namespace {

namespace fs = std::filesystem;

// A built-in profile as of a GPU.
std::string gpu(const std::string& profile, const std::string& folder) {
  auto p = std::get<target::Profile>(target::load_profile(profile));
  p.subgroup_size = 32;
  p.lanes_in_turn = false;
  p.loop_trips = 0;
  auto path = (fs::path(folder) / "gpu.json").string();
  std::ofstream(path) << target::write_profile(p);
  return path;
}

// One side of a case: the program compiled and loaded, with what compiling left out.
struct Side {
  std::vector<jit::Skip> compiled;
  Program program;
};

Side side_of(const Case& c, const test::NamedDevice& device, bool off, const std::string& define,
             const std::string& folder) {
  const fs::path path = fs::path(folder) / "skip.dr";
  std::ofstream(path) << "edition 1;\n" << c.text;
  jit::Options options;
  options.profile = c.as_gpu ? gpu(device.name, folder) : device.name;
  options.raster = c.raster;
  options.scatter = c.scatter;
  options.known = c.known;
  if (!define.empty()) options.defines[define.substr(0, define.find('='))] = define.substr(define.find('=') + 1);
  runtime::LoadOptions load{.pipeline_folder = folder};
  const auto names = jit::skip_names();
  if (off && std::ranges::find(names, c.id) != names.end()) options.ablate = {c.id};
  if (off && c.id == "shaders") options.shader_cache = false;
  if (off && c.id == "cache") load.cache = false;
  if (off && c.id == "commands") load.reuse_commands = false;
  if (off && c.id == "pipelines") load.pipeline_folder.clear();
  jit::Told told;
  auto bundle = jit::compile_file(path.string(), options, &told);
  if (!bundle) FAIL(bundle.error());
  return {std::move(told.skips), must(Program::load(device.device, *bundle, load))};
}

void bind(Program& program, const Bound& bound) {
  for (const auto& [leaf, data] : bound) must(program.bind(leaf, data));
}

// What `run` gave, outputs and params.
std::map<std::string, std::vector<std::byte>> results(Program& program) {
  std::map<std::string, std::vector<std::byte>> out;
  for (const std::string& name : program.outputs("go")) out[name] = must(program.output("go", name)).bytes;
  for (const auto& leaf : program.leaves())
    if (!program.is_input(leaf.name)) out["leaf " + leaf.name] = must(program.leaf(leaf.name)).bytes;
  return out;
}

// Runs five times more; what those runs did and avoided of what the case is about.
Count measured(const Case& c, Side& side) {
  Program& p = side.program;
  const auto before = p.counters("go");
  must(p.run("go", 4));
  const auto commands = must(p.timed_run("go"));
  const auto after = p.counters("go");
  if (c.id == "cache")
    return {after.run.commands - before.run.commands, after.skipped.commands - before.skipped.commands};
  if (c.id == "commands") {
    const int64_t recorded = after.recorded - before.recorded;
    return {recorded, after.runs - before.runs - recorded};
  }
  if (c.id == "pipelines") return {p.pipelines().made - p.pipelines().kept, p.pipelines().kept};
  Count count;
  if (c.id == "soft") {
    for (const auto& command : commands) count.done += command.fragments;
    return count;
  }
  for (const auto& command : commands)
    if (command.list == c.id) count.done += command.listed, count.avoided += command.elements - command.listed;
  for (const jit::Skip& skip : side.compiled)
    if (skip.id == c.id) count = {skip.done, skip.avoided};
  return count;
}

}  // namespace

TEST_CASE("what is left out is counted, changes no bit, and is done when it is needed") {
  const fs::path root = fs::path(DR_BUILD_DIR) / "skip_test";
  for (const test::NamedDevice& device : test::devices()) {
    for (const Case& c : cases()) {
      if (!c.only_on.empty() && c.only_on != device.name) continue;
      INFO(c.id << " on " << device.name);
      fs::remove_all(root);
      fs::create_directories(root);
      setenv("DRC_CACHE_DIR", root.c_str(), 1);
      const std::string folder = root.string();
      const bool of_disk = c.id == "pipelines" || c.id == "shaders";
      if (of_disk) {  // there is something to find
        Side first = side_of(c, device, false, {}, folder);
        bind(first.program, c.bound);
        CHECK(measured(c, first).avoided == 0);
      }
      Side with = side_of(c, device, false, {}, folder), without = side_of(c, device, true, {}, folder);
      // The steps of a cached prologue run once where nothing changes, and are looked at then.
      bind(with.program, c.bound);
      bind(without.program, c.bound);
      CHECK(measured(c, with) == c.with);
      CHECK(measured(c, without) == c.without);
      const auto before = results(with.program);
      CHECK(before == results(without.program));

      // Woken: by data in the same program, or compiled anew.
      const Array data = c.data;
      if (!c.leaf.empty()) {
        must(with.program.bind(c.leaf, data));
        must(without.program.bind(c.leaf, data));
        CHECK(measured(c, with) == c.woken);
        measured(c, without);
      } else {
        with = side_of(c, device, false, c.define, folder);
        without = side_of(c, device, true, c.define, folder);
        bind(with.program, c.bound);
        bind(without.program, c.bound);
        CHECK(measured(c, with) == c.woken);
        measured(c, without);
      }
      const auto woken = results(with.program);
      CHECK(woken == results(without.program));
      CHECK(woken != before);
      for (const std::string& message : device.device.validation_messages()) FAIL("validation: " << message);
    }
  }
}

TEST_CASE("an input that is known keeps its value, but where its gradient is asked for") {
  constexpr const char* kText = R"(edition 1;
input strength : float = 1.0;
param a : float = 0.5;
fn layered(factor: float, a: float) -> float { const if known_zero(factor) { a } else { factor * exp(a) + a } }
step go { a <- a - 0.1 * grad(layered(strength, a), a); output y = layered(strength, a); }
)";
  const fs::path root = fs::path(DR_BUILD_DIR) / "skip_test";
  fs::create_directories(root);
  const std::string path = (root / "known.dr").string();
  for (const test::NamedDevice& device : test::devices()) {
    INFO(device.name);
    const auto compiled = [&](const std::string& more, const std::string& name, const jit::Options& with = {}) {
      std::ofstream(path) << kText << more;
      jit::Options options = with;
      options.profile = device.name;
      options.known[name] = {0};
      return jit::compile_file(path, options);
    };
    const auto program_of = [&](const std::string& more, const jit::Options& with = {}) {
      const auto bundle = compiled(more, "strength", with);
      if (!bundle) FAIL(bundle.error());
      return must(Program::load(device.device, *bundle));
    };
    const auto y_of = [&](Program& program) {
      must(program.run("go"));
      return must(program.output("go", "y")).as<float>()[0];
    };

    // Its value stands where nothing is bound, and nothing else can be.
    Program known = program_of("");
    CHECK(y_of(known) == 0.5f);
    must(known.bind("strength", floats({0}, 1)));
    must(known.bind("strength", floats({-0.0f}, 1)));
    must(known.bind("strength", Array::from_doubles(std::vector<double>{0}, 1, 1, 1, 1)));
    const auto refused = known.bind("strength", floats({1}, 1));
    REQUIRE(!refused);
    CHECK(
        refused.error() ==
        "leaf 'strength' was given as 0 when the program was compiled, which left out what that makes zero; compile it "
        "without for other values");
    CHECK(!must(known.leaf_view("strength")));

    // Where it is sought, or what is made of it, it may have any.
    Program sought = program_of("step look { output slope = grad(layered(2.0 * strength, a), strength); }");
    CHECK(y_of(sought) == 0.5f);
    must(sought.run("look"));
    CHECK(std::abs(must(sought.output("look", "slope")).as<float>()[0] -
                   2 * std::exp(must(sought.leaf("a")).as<float>()[0])) < 1e-5f);
    must(sought.bind("strength", floats({1}, 1)));
    CHECK(y_of(sought) > 1.5f);
    jit::Options seeking;
    seeking.adjoints = {"go:strength:y"};
    Program adjoint = program_of("", seeking);
    must(adjoint.bind("strength", floats({1}, 1)));
    CHECK(y_of(adjoint) > 1.5f);

    CHECK(!compiled("", "a"));
    CHECK(!compiled("", "nothing"));
  }
}
