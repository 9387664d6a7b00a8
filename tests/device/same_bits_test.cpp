// SPDX-License-Identifier: Apache-2.0
// The same input gives the same bits on one device: every program of tests/golden/programs and the examples, started
// again and again, and with buffers that are bound in parts. Drivers compile the long shaders of some for minutes:
// those of few ops run twice, and all of them, made twice, as often as DR_SAME_BITS_RUNS says where it is set.
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <set>
#include <sstream>
#include <utility>

#include "compiler/driver/driver.h"
#include "runtime/jit/jit.h"
#include "runtime/runtime.h"
#include "tests/catch.h"
#include "tests/device/compile.h"
#include "tests/device/devices.h"
#include "tests/device/in_parts.h"

using namespace dr;
using io::Array;
using runtime::Program;
using test::must;
namespace fs = std::filesystem;

namespace {

using Values = std::map<std::string, Array>;

struct Job {
  fs::path file;
  std::vector<std::string> steps;  // empty: all
  int times = 1;
  std::map<std::string, std::string> sources;  // by leaf
  Values data;                                 // by leaf
  std::map<std::string, std::string, std::less<>> defines = {};
  std::map<std::string, int64_t> symbols = {};
};

// What the program's own //TEST lines bind.
Job job_of(const fs::path& file) {
  Job job{file, {}, 2, {}, {}};
  std::ifstream text(file);
  for (std::string line; std::getline(text, line) && line.starts_with("//TEST");) {
    std::stringstream words(line);
    for (std::string word; words >> word;) {
      if (word != "--bind" && word != "--symbol") continue;
      const bool is_symbol = word == "--symbol";
      words >> word;
      const std::string name = word.substr(0, word.find('=')), value = word.substr(word.find('=') + 1);
      if (is_symbol)
        job.symbols[name] = std::stoll(value);
      else
        job.sources[name] = value;
    }
  }
  return job;
}

int in_parts = 0;  // programs of which a leaf or an output was

const char* wanted() { return std::getenv("DR_SAME_BITS_RUNS"); }

// Of a program as it is checked, before anything is derived or compiled.
size_t ops_of(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  driver::Options options;
  options.include_dirs = {file.parent_path().string()};
  driver::Compilation program(file.string(), {std::istreambuf_iterator<char>(stream), {}}, options);
  const ir::Graph* graph = program.lowered();
  return graph == nullptr ? 0 : graph->op_count();
}

std::vector<Job> golden_programs() {
  constexpr size_t kFew = 250;
  std::vector<Job> jobs;
  for (const auto& entry : fs::directory_iterator(fs::path(DR_SOURCE_DIR) / "tests/golden/programs"))
    if (entry.path().extension() == ".dr" && (wanted() || ops_of(entry.path()) <= kFew))
      jobs.push_back(job_of(entry.path()));
  std::sort(jobs.begin(), jobs.end(), [](const Job& a, const Job& b) { return a.file < b.file; });
  REQUIRE(jobs.size() > 10);
  return jobs;
}

std::vector<uint8_t> compile(const Job& job, const std::string& profile) {
  jit::Options options;
  options.profile = profile;
  options.defines = job.defines;
  return test::compile(job.file.string(), options);
}

// From the start: everything is bound, each step runs `times` times. Outputs as STEP.NAME, then the leaves.
Values results(Program& program, const Job& job, const Values& start) {
  for (const auto& [leaf, data] : start) must(program.bind(leaf, data));
  const std::vector<std::string> steps = job.steps.empty() ? program.steps() : job.steps;
  Values out;
  std::set<std::string> leaves;
  for (const std::string& step : steps) {
    must(program.set_runs(step, 0));
    must(program.run(step, job.times));
    for (const std::string& name : program.outputs(step)) out[step + "." + name] = must(program.output(step, name));
    for (const std::string& leaf : program.needed_leaves(step)) leaves.insert(leaf);
  }
  for (const std::string& leaf : leaves) out[leaf] = must(program.leaf(leaf));
  return out;
}

// What the program starts from.
Values start_of(Program& program, const Job& job) {
  Values start = job.data;
  for (const auto& leaf : program.leaves())
    if (const auto it = job.sources.find(leaf.name); it != job.sources.end())
      start.insert_or_assign(leaf.name, must(io::load_binding(it->second, leaf.components)));
  for (const auto& [leaf, data] : start) must(program.bind(leaf, data));
  // What has a value without being bound starts from it again, too.
  for (const auto& leaf : program.leaves())
    if (auto value = start.count(leaf.name) == 0 && !program.is_input(leaf.name) ? program.leaf(leaf.name)
                                                                                 : io::Result<Array>(io::Error{});
        value)
      start.insert_or_assign(leaf.name, *value);
  return start;
}

void check_equal(const Values& now, const Values& first, const std::string& when) {
  REQUIRE(now.size() == first.size());
  for (const auto& [name, value] : now)
    if (value.bytes != first.at(name).bytes) FAIL_CHECK(name << " differs " << when);
}

// With buffers in parts, as many as the device binds. Says whether any value has several.
bool check_in_parts(const test::NamedDevice& device, const Job& job, const std::vector<uint8_t>& bundle,
                    const Values& first) {
  std::vector<std::string> steps = job.steps;
  if (steps.empty()) steps = must(Program::describe(bundle)).steps();
  auto [program, bytes] = test::load_in_parts(device.device, bundle, steps, 16, [&](Program& fresh) {
    for (const auto& [symbol, value] : job.symbols) must(fresh.bind_symbol(symbol, value));
    start_of(fresh, job);
  });
  check_equal(results(program, job, start_of(program, job)), first,
              "with " + std::to_string(bytes) + " bytes a binding");
  return std::ranges::any_of(
      first, [most = bytes](const auto& value) { return static_cast<int64_t>(value.second.bytes.size()) > most; });
}

// The values of the first run.
Values check_job(const test::NamedDevice& device, const Job& job, int runs) {
  INFO(job.file.filename().string() << " on " << device.name);
  const std::vector<uint8_t> bundle = compile(job, device.name);
  Values first;
  for (int build = 0; build < (wanted() ? 2 : 1); ++build) {
    // Without the cache all of it runs each time.
    Program program = must(Program::load(device.device, bundle, {.cache = false}));
    for (const auto& [symbol, value] : job.symbols) must(program.bind_symbol(symbol, value));
    const Values start = start_of(program, job);
    for (int run = 0; run < runs; ++run) {
      Values now = results(program, job, start);
      if (first.empty()) first = now;
      check_equal(now, first, "in run " + std::to_string(run) + " of build " + std::to_string(build));
    }
  }
  if (check_in_parts(device, job, bundle, first)) ++in_parts;
  return first;
}

int wanted_runs() { return wanted() ? std::max(1, std::atoi(wanted())) : 2; }

void check_messages(const test::NamedDevice& device) {
  for (const std::string& message : device.device.validation_messages()) FAIL("validation: " << message);
}

}  // namespace

TEST_CASE("programs give the same bits each time") {
  const std::vector<Job> jobs = golden_programs();
  for (const test::NamedDevice& device : test::devices()) {
    size_t values = 0;
    for (const Job& job : jobs) values += check_job(device, job, wanted_runs()).size();
    std::printf("%-12s %zu values of %zu programs, %d of them with buffers in parts\n", device.name.c_str(), values,
                jobs.size(), in_parts);
    CHECK(std::exchange(in_parts, 0) > 5);
    check_messages(device);
  }
}

TEST_CASE("examples give the same bits each time") {
  if (!wanted()) return;
  const fs::path examples = fs::path(DR_SOURCE_DIR) / "docs/examples";
  const auto file = [&](const char* name) { return (examples / name).string(); };
  for (const test::NamedDevice& device : test::devices()) {
    Values target = check_job(
        device,
        {examples / "render_target.dr",
         {},
         1,
         {{"position", file("pear.obj:position")}, {"face", file("pear.obj:indices")}, {"view", file("views.json")}},
         {},
         {{"samples", "2"}}},
        wanted_runs());
    const std::string step =
        must(Program::describe(compile({examples / "render_target.dr", {}, 1, {}, {}}, device.name))).steps()[0];
    check_job(device,
              {examples / "fit_sphere.dr",
               {},
               2,
               {{"position", file("sphere.obj:position")},
                {"face", file("sphere.obj:indices")},
                {"view", file("views.json")}},
               {{"target", target.at(step + ".target")}, {"photo", target.at(step + ".photo")}}},
              wanted_runs());
    check_messages(device);
  }
}

TEST_CASE("the pear's example gives the same bits each time") {
  if (!wanted()) return;
  const fs::path pear = fs::path(DR_SOURCE_DIR) / "docs/examples/pear";
  for (const test::NamedDevice& device : test::devices()) {
    const std::map<std::string, std::string, std::less<>> small{{"W", "48"},      {"H", "48"},   {"T", "32"},
                                                                {"samples", "2"}, {"fine", "6"}, {"coarse", "4"}};
    const Values target = check_job(device, {pear / "target.dr", {}, 1, {}, {}, small}, wanted_runs());
    Values data;
    for (const char* name : {"position", "face", "uv", "uv_face"})
      data[name] = target.at(std::string("meshes.") + name);
    for (const char* name : {"view", "mask", "image"}) data[name] = target.at(std::string("render.") + name);
    check_job(device, {pear / "fit.dr", {"fit_shape", "fit_texture", "measure_pictures"}, 2, {}, data, {{"T", "32"}}},
              wanted_runs());
    check_messages(device);
  }
}
