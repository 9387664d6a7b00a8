// SPDX-License-Identifier: Apache-2.0
// Schedules of one program: how many passes and stages each profile takes, and whether the costs that a profile
// predicts put schedules into the order in which a device runs them.
//
//   bench_schedules FILE tables PROGRAM NAME=NUMBER...
//     passes, stages and bytes by profile and ablation, of a first run and of later ones, beside lower bounds
//   bench_schedules FILE order EVERY DEVICE PROGRAM NAME=NUMBER... LEAF=SOURCE...
//     predicted against measured times of each EVERYth of 50
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <numeric>
#include <sstream>
#include <string>
#include <vector>

#include "compiler/backend/compile.h"
#include "compiler/backend/report.h"
#include "compiler/backend/skips.h"
#include "compiler/backend/spirv/shader_cache.h"
#include "compiler/io/array/array.h"
#include "compiler/lower/lower.h"
#include "compiler/passes/passes.h"
#include "compiler/target/profile.h"
#include "dsl/diagnostic/diagnostic.h"
#include "runtime/runtime.h"
#include "tests/must.h"

using namespace dr;

namespace {

using benchmark::must;
using benchmark::stop;

template <class T>
T must(std::variant<T, std::string> result) {
  if (const auto* problem = std::get_if<std::string>(&result)) stop(*problem);
  return std::get<T>(std::move(result));
}

std::pair<std::string, std::string> split(const std::string& argument) {
  const size_t at = argument.find('=');
  if (at == std::string::npos) stop("expected NAME=VALUE, found '" + argument + "'");
  return {argument.substr(0, at), argument.substr(at + 1)};
}

ir::Graph graph_of(const std::string& path, const target::Profile& profile) {
  std::ifstream file(path, std::ios::binary);
  std::stringstream text;
  text << file.rdbuf();
  if (!file) stop("cannot read '" + path + "'");
  dsl::SourceManager sources;
  dsl::DiagnosticList diagnostics;
  lower::Options options;
  for (auto& define : backend::build_defines({}, profile)) options.defines.insert(std::move(define));
  const auto graph = lower::lower(sources, sources.add(path, text.str()), options, diagnostics);
  if (!graph) stop(dsl::format(diagnostics, sources));
  passes::PipelineOptions pipeline;
  pipeline.verify_each = false;
  return passes::run_passes(*graph, passes::default_passes(), pipeline);
}

// A way to compile: the words of drc's options.
struct Way {
  std::string lower = "auto", raster = "auto", pack = "fused";
  std::vector<std::string> ablate = {};
  std::string scatter = "auto";
  std::string str() const {
    std::string text = lower + " " + raster + " " + pack + " " + scatter;
    for (const std::string& part : ablate) text += " -" + part;
    return text;
  }
};

backend::Compiled compile(const ir::Graph& graph, const target::Profile& profile, const Way& way) {
  auto options = must(backend::compile_options(way.lower, way.raster, way.pack, way.ablate, way.scatter));
  options.cache_folder = backend::default_cache_folder();
  auto compiled = backend::compile(graph, profile, options);
  if (const auto* limit = std::get_if<backend::Limit>(&compiled)) benchmark::stop(limit->text);
  return std::get<backend::Compiled>(std::move(compiled));
}

// ---- tables ----

void tables(std::FILE* file, const std::string& program, const std::vector<std::string>& arguments) {
  ir::SymbolValues symbols;
  for (const std::string& argument : arguments) {
    const auto [name, value] = split(argument);
    symbols[name] = std::atoll(value.c_str());
  }
  const std::vector<std::pair<const char*, Way>> ways = {
      {"full", {}},
      {"-stages", {.ablate = {"stages"}}},
      {"-cache", {.ablate = {"cache"}}},
      {"-remat", {.ablate = {"remat"}}},
      {"-substages", {.ablate = {"substages"}}},
      {"naive", {.pack = "naive"}},
  };
  // What a way gives of a step, by step, in the order of profiles and ways.
  std::vector<std::vector<std::string>> lines;
  for (const std::string& name : target::builtin_profiles()) {
    const auto profile = must(target::load_profile(name));
    const ir::Graph graph = graph_of(program, profile);
    lines.resize(graph.steps.size());
    for (const auto& [title, way] : ways) {
      const backend::Report report = must(backend::report(graph, compile(graph, profile, way), profile, symbols));
      for (size_t s = 0; s < report.steps.size(); ++s) {
        const backend::StepReport& step = report.steps[s];
        const auto print = [&](const char* runs, const backend::RunReport& run) {
          const double megabytes = 1e-6 * static_cast<double>(run.bytes_read + run.bytes_written);
          const double least = 1e-6 * static_cast<double>(run.least.bytes);
          char line[200];
          std::snprintf(line, sizeof line, "%-17s %-15s %-11s %-6s %5zu %9zu %6zu (%2zu) %7.1f (%5.1f) %9.2f\n",
                        step.name.c_str(), name.c_str(), title, runs, step.ops, run.passes, run.stages,
                        run.least.stages, megabytes, least, 1e-6 * run.expected_ns);
          lines[s].emplace_back(line);
          std::fprintf(file,
                       "{\"bench\": \"schedules\", \"step\": \"%s\", \"profile\": \"%s\", \"packing\": \"%s\", "
                       "\"runs\": \"%s\", \"ops\": %zu, \"substages\": %zu, \"stages\": %zu, \"least_stages\": %zu, "
                       "\"megabytes\": %.3f, \"least_megabytes\": %.3f, \"expected_ms\": %.4f}\n",
                       step.name.c_str(), name.c_str(), title, runs, step.ops, run.passes, run.stages, run.least.stages,
                       megabytes, least, 1e-6 * run.expected_ns);
        };
        print("first", step.first);
        if (way.ablate.empty() && way.pack == "fused") print("later", step.steady);
      }
    }
  }
  std::printf("In brackets: what no schedule can do without.\n%-17s %-15s %-11s %-6s %5s %9s %11s %15s %9s\n", "step",
              "profile", "packing", "runs", "ops", "substages", "stages", "MB moved", "exp. ms");
  for (const auto& of_step : lines)
    for (const std::string& line : of_step) std::fputs(line.c_str(), stdout);
}

// ---- order ----

// Ranks, ties sharing their mean.
std::vector<double> ranks(const std::vector<double>& values) {
  std::vector<size_t> order(values.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::sort(order.begin(), order.end(), [&](size_t a, size_t b) { return values[a] < values[b]; });
  std::vector<double> rank(values.size());
  for (size_t i = 0; i < order.size();) {
    size_t j = i;
    while (j < order.size() && values[order[j]] == values[order[i]]) ++j;
    for (size_t k = i; k < j; ++k) rank[order[k]] = 0.5 * static_cast<double>(i + j - 1);
    i = j;
  }
  return rank;
}

double correlation(const std::vector<double>& x, const std::vector<double>& y) {
  const double n = static_cast<double>(x.size());
  const double mx = std::accumulate(x.begin(), x.end(), 0.0) / n, my = std::accumulate(y.begin(), y.end(), 0.0) / n;
  double xy = 0, xx = 0, yy = 0;
  for (size_t k = 0; k < x.size(); ++k) {
    xy += (x[k] - mx) * (y[k] - my);
    xx += (x[k] - mx) * (x[k] - mx);
    yy += (y[k] - my) * (y[k] - my);
  }
  return xy / std::sqrt(xx * yy);
}

std::vector<Way> fifty_ways() {
  std::vector<Way> ways;
  const std::vector<std::vector<std::string>> off = {{},
                                                     {"stages"},
                                                     {"cache"},
                                                     {"remat"},
                                                     {"substages"},
                                                     {"substages", "stages"},
                                                     {"substages", "remat"},
                                                     {"stages", "remat"},
                                                     {"stages", "remat", "substages"},
                                                     {"stages", "cache"}};
  for (const char* lower : {"compute", "fragment"})
    for (const char* raster : {"compute", "hardware"})
      for (const auto& ablate : off) ways.push_back({lower, raster, "fused", ablate, "auto"});
  for (const char* lower : {"compute", "fragment"})
    for (const auto& ablate : {off[0], off[2], off[3], off[4], off[6]})
      ways.push_back({lower, "compute", "fused", ablate, "exact"});
  return ways;
}

void order(std::FILE* file, size_t every, const std::string& wanted, const std::string& program,
           const std::vector<std::string>& arguments) {
  const auto device = must(runtime::Device::open({wanted, false}));
  const std::string name = device.profile_name().empty() ? "lavapipe" : device.profile_name();
  const auto profile = must(target::load_profile(name));
  const ir::Graph graph = graph_of(program, profile);
  std::printf("%s, profile %s\n%-52s %12s %12s\n", device.info().name.c_str(), name.c_str(), "schedule", "predicted ms",
              "measured ms");
  const std::string step = graph.steps[0].name;
  using Clock = std::chrono::steady_clock;
  const auto milliseconds = [&](runtime::Program& loaded, int runs) {
    const auto begin = Clock::now();
    must(loaded.run(step, runs));
    return std::chrono::duration<double, std::milli>(Clock::now() - begin).count() / runs;
  };
  std::vector<Way> ways;
  const std::vector<Way> all = fifty_ways();
  for (size_t k = 0; k < all.size(); k += every) ways.push_back(all[k]);
  std::vector<double> predicted;
  std::vector<runtime::Program> programs;
  for (const Way& way : ways) {
    const backend::Compiled compiled = compile(graph, profile, way);
    auto loaded = must(runtime::Program::load(device, bundle::write(compiled.bundle)));
    ir::SymbolValues symbols;
    for (const std::string& argument : arguments) {
      const auto [leaf, source] = split(argument);
      if (source.find_first_not_of("0123456789") == std::string::npos) {
        symbols[leaf] = std::atoll(source.c_str());
        continue;
      }
      int components = 0;
      for (const auto& info : loaded.leaves())
        if (info.name == leaf) components = info.components;
      if (components == 0) stop("there is no leaf '" + leaf + "'");
      must(loaded.bind(leaf, must(io::load_binding(source, components))));
    }
    milliseconds(loaded, 2);
    const backend::Report report = must(backend::report(graph, compiled, profile, symbols));
    predicted.push_back(1e-6 * report.steps[0].first.expected_ns);
    programs.push_back(std::move(loaded));
  }
  // In turns, so that a machine whose speed drifts treats all alike; first a turn that wakes it up.
  std::vector<std::vector<double>> times(ways.size());
  for (int round = 0; round < 12; ++round)
    for (size_t k = 0; k < ways.size(); ++k) {
      const double warm = milliseconds(programs[k], 2);
      const double time = milliseconds(programs[k], std::max(2, static_cast<int>(20 / warm)));
      if (round > 0) times[k].push_back(time);
    }
  std::vector<double> measured;
  for (size_t k = 0; k < ways.size(); ++k) {
    std::sort(times[k].begin(), times[k].end());
    measured.push_back(times[k][times[k].size() / 2]);
    std::printf("%-52s %12.3f %12.3f\n", ways[k].str().c_str(), predicted[k], measured[k]);
    std::fprintf(file,
                 "{\"bench\": \"schedules\", \"schedule\": \"%s\", \"predicted_ms\": %.4f, \"measured_ms\": %.4f}\n",
                 ways[k].str().c_str(), predicted[k], measured[k]);
  }
  const double rank = correlation(ranks(predicted), ranks(measured));
  std::printf("rank correlation over %zu schedules: %.3f\n", predicted.size(), rank);
  std::fprintf(file,
               "{\"bench\": \"schedules\", \"what\": \"rank correlation\", \"schedules\": %zu, \"value\": %.4f}\n",
               predicted.size(), rank);
}

}  // namespace

int main(int argc, char** argv) {
  const std::string what = argc > 2 ? argv[2] : "";
  const int every = what == "order" && argc > 5 ? std::atoi(argv[3]) : 0;
  std::FILE* file = (what == "tables" && argc > 3) || every > 0 ? std::fopen(argv[1], "w") : nullptr;
  if (file == nullptr) {
    std::fputs(
        "usage: bench_schedules FILE tables PROGRAM ARGUMENT...\n"
        "       bench_schedules FILE order EVERY DEVICE PROGRAM ARGUMENT...\n",
        stderr);
    return 2;
  }
  const std::vector<std::string> arguments(argv + (every > 0 ? 6 : 4), argv + argc);
  every > 0 ? order(file, static_cast<size_t>(every), argv[4], argv[5], arguments) : tables(file, argv[3], arguments);
  std::fclose(file);
  return 0;
}
