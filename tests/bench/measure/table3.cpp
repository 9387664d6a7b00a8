// SPDX-License-Identifier: Apache-2.0
// What stage packing and the reactive cache are worth, as in the paper's Table 3: the steps of one program compiled in
// five ways, all in one process, in rounds in which each takes its turn. A step runs TIMES times at most: then it
// starts over, as what a step of a fit takes depends on how far the fit is. All ways must end with the same bits.
//
//   bench_table3 FILE PROGRAM DEVICE ROUNDS STEP=TIMES... -- LEAF=SOURCE...    a table on stdout, JSON in FILE
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <nlohmann/json.hpp>

#include "runtime/jit/jit.h"
#include "runtime/runtime.h"
#include "tests/must.h"

using namespace dr;

namespace {

using benchmark::must;
using benchmark::stop;

struct Way {
  const char* name;
  const char* pack = "fused";
  std::vector<std::string> ablate = {};
  bool cache = true;
};

// "Stage packing" joins passes into render passes and runs of dispatches; without the cache there is no prologue
// either.
const std::vector<Way> kWays = {{"full"},
                                {"-stage pack", "fused", {"stages"}},
                                {"-reactive cache", "fused", {"cache"}, false},
                                {"-both", "fused", {"stages", "cache"}, false},
                                {"naive", "naive", {"cache"}, false}};

struct Runner {
  Way way;
  runtime::Program program;
  std::vector<std::pair<std::string, io::Array>> start = {};  // of what the step that is measured changes
  int done = 0;                                               // since it started over
  std::vector<double> ms = {}, processor_ms = {};             // a step, of the one that is measured
};

double now_ms() {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

// Of all threads of this process: what a device on the processor takes, whatever else runs there.
double processor_ms() {
  timespec time;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &time);
  return 1e3 * static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_nsec);
}

double quantile(std::vector<double> values, double q) {
  std::sort(values.begin(), values.end());
  return values[static_cast<size_t>(std::lround(q * static_cast<double>(values.size() - 1)))];
}

void start_over(Runner& r, const std::string& step) {
  for (const auto& [leaf, content] : r.start) must(r.program.bind(leaf, content));
  must(r.program.set_runs(step, 0));
  r.done = 0;
}

double run(Runner& r, const std::string& step, int times) {
  const double begin = now_ms(), processor = processor_ms();
  must(r.program.run(step, times));
  r.ms.push_back((now_ms() - begin) / times);
  r.processor_ms.push_back((processor_ms() - processor) / times);
  return r.ms.back();
}

}  // namespace

int main(int argc, char** argv) {
  std::vector<std::string> steps, bindings;
  bool behind = false;
  for (int k = 5; k < argc; ++k) {
    if (const std::string word = argv[k]; word == "--")
      behind = true;
    else
      (behind ? bindings : steps).push_back(word);
  }
  const int rounds = argc > 4 ? std::atoi(argv[4]) : 0;
  if (steps.empty() || rounds < 1) {
    std::fputs("usage: bench_table3 FILE PROGRAM DEVICE ROUNDS STEP=TIMES... -- LEAF=SOURCE...\n", stderr);
    return 2;
  }
  const auto device = must(runtime::Device::open({argv[3], false}));
  const std::string profile = device.profile_name().empty() ? "lavapipe" : device.profile_name();
  std::vector<Runner> runners;
  for (const Way& way : kWays) {
    jit::Options options;
    options.profile = profile;
    options.pack = way.pack;
    options.ablate = way.ablate;
    auto bundle = jit::compile_file(argv[2], options);
    if (!bundle) stop(bundle.error());
    runners.push_back(
        {way, must(runtime::Program::load(device, *bundle, {.cache = way.cache, .pipeline_folder = {}}))});
    runtime::Program& program = runners.back().program;
    for (const std::string& binding : bindings) {
      const size_t at = binding.find('=');
      const std::string leaf = binding.substr(0, at);
      int components = 0;
      for (const auto& info : program.leaves())
        if (info.name == leaf) components = info.components;
      if (components == 0) stop("there is no leaf '" + leaf + "'");
      must(program.bind(leaf, must(io::load_binding(binding.substr(at + 1), components))));
    }
  }

  nlohmann::json report = {{"bench", "table3"},
                           {"device", device.info().name},
                           {"profile", profile},
                           {"rounds", rounds},
                           {"rows", nlohmann::json::array()}};
  std::printf("%s, profile %s, medians of %d rounds\n", device.info().name.c_str(), profile.c_str(), rounds);
  for (const std::string& word : steps) {
    const std::string step = word.substr(0, word.find('='));
    const int most = std::atoi(word.substr(std::min(word.size(), step.size() + 1)).c_str());
    if (most < 1) stop("how often does '" + step + "' run?");
    std::printf("%-14s %-16s %10s %20s %8s %13s %8s %12s %8s %9s\n", step.c_str(), "", "ms a step", "quartiles",
                "x slower", "processor ms", "x slower", "commands run", "MB run", "left out");
    // Warm: shaders compiled, the cache steady. Then every way runs as often as every other, so that all are at the
    // same point of the fit: for a second or a step at least, and not beyond the fit's end.
    double slowest = 0;
    for (Runner& r : runners) {
      r.start.clear();
      for (const auto& info : r.program.leaves())
        if (r.program.changes(step, info.name)) r.start.emplace_back(info.name, must(r.program.leaf(info.name)));
      run(r, step, 3);
      slowest = std::max(slowest, run(r, step, 1));
      start_over(r, step);
    }
    for (Runner& r : runners) r.ms.clear(), r.processor_ms.clear();
    const int times = std::clamp(static_cast<int>(1000 / slowest), 1, most);
    std::vector<runtime::StepCounters> before;
    for (Runner& r : runners) before.push_back(r.program.counters(step));
    for (int round = 0; round < rounds; ++round)
      for (Runner& r : runners) {
        if (r.done + times > most) start_over(r, step);
        run(r, step, times);
        r.done += times;
      }
    for (size_t k = 0; k < runners.size(); ++k) {
      Runner& r = runners[k];
      const auto after = r.program.counters(step);
      const double runs = static_cast<double>(rounds) * times;
      const double commands = static_cast<double>(after.run.commands - before[k].run.commands) / runs;
      const double skipped = static_cast<double>(after.skipped.commands - before[k].skipped.commands) / runs;
      const double megabytes = 1e-6 * static_cast<double>(after.run.bytes - before[k].run.bytes) / runs;
      const double median = quantile(r.ms, 0.5), ratio = median / quantile(runners[0].ms, 0.5);
      const double processor = quantile(r.processor_ms, 0.5),
                   processor_ratio = processor / quantile(runners[0].processor_ms, 0.5);
      char spread[40];
      std::snprintf(spread, sizeof spread, "%.3f … %.3f", quantile(r.ms, 0.25), quantile(r.ms, 0.75));
      std::printf("%-14s %-16s %10.3f %20s %8.2f %13.3f %8.2f %12.0f %8.1f %9.0f\n", "", r.way.name, median, spread,
                  ratio, processor, processor_ratio, commands, megabytes, skipped);
      report["rows"].push_back({{"step", step},
                                {"way", r.way.name},
                                {"median_ms", median},
                                {"low_quartile_ms", quantile(r.ms, 0.25)},
                                {"high_quartile_ms", quantile(r.ms, 0.75)},
                                {"smallest_ms", quantile(r.ms, 0)},
                                {"steps_a_round", times},
                                {"ratio", ratio},
                                {"processor_ms", processor},
                                {"processor_ratio", processor_ratio},
                                {"commands", commands},
                                {"skipped_commands", skipped},
                                {"megabytes", megabytes}});
    }
    for (const auto& leaf : runners[0].program.leaves()) {
      const auto needed = runners[0].program.needed_leaves(step);
      if (std::find(needed.begin(), needed.end(), leaf.name) == needed.end()) continue;
      const auto first = must(runners[0].program.leaf(leaf.name)).bytes;
      for (Runner& r : runners)
        if (must(r.program.leaf(leaf.name)).bytes != first)
          stop("after " + step + " '" + leaf.name + "' has other bits in " + r.way.name + " than in full");
    }
  }
  std::printf("All ways end with the same bits.\n");
  std::ofstream(argv[1]) << report.dump(1) << "\n";
  return 0;
}
