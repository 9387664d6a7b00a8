// SPDX-License-Identifier: Apache-2.0
// Counting what a compiled program does.
#include "compiler/backend/report.h"

#include <algorithm>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <set>

#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/cost/cost.h"
#include "compiler/backend/plan/dependencies.h"
#include "compiler/ir/initial_step.h"

namespace dr::backend {

namespace {

RunReport run_report(const ir::Graph& graph, const Compiled& compiled, size_t index, const target::Profile& profile,
                     const ir::SymbolValues& symbols, bool steady) {
  RunReport r;
  StepSchedule step = compiled.schedule.steps[index];
  if (steady) std::erase_if(step.passes, [](const Pass& pass) { return !pass.steady; });
  std::set<uint32_t> stages;
  for (const Pass& pass : step.passes) stages.insert(pass.stage);
  r.passes = step.passes.size();
  r.stages = stages.size();
  r.expected_ns = step_cost(graph, compiled.schedule, step, profile, symbols).value_or(0);
  for (const auto& command : compiled.bundle.steps[index]->commands) {
    if (steady && !command->steady) continue;
    for_each_access(*command, [&](uint32_t resource, bundle::Access access) {
      const bundle::ResourceT& touched = *compiled.bundle.resources[resource];
      if (touched.storage == bundle::Storage::Tile) return;  // never leaves its render pass
      if (touched.role == bundle::Role::Watch) return;       // touched where something went wrong
      const int64_t bytes = *resource_bytes(touched, symbols);
      if (access != bundle::Access::Write) r.bytes_read += bytes;
      if (access != bundle::Access::Read) r.bytes_written += bytes;
    });
  }
  r.least = lower_bound(graph, graph.steps[index], symbols, steady).value_or(LowerBound{});
  return r;
}

}  // namespace

std::variant<Report, std::string> report(const ir::Graph& graph, const Compiled& compiled,
                                         const target::Profile& profile, const ir::SymbolValues& symbols,
                                         const passes::Skips::LeftOut& left_out) {
  const bundle::BundleT& bundle = compiled.bundle;
  for (const std::string& symbol : bundle.symbols)
    if (symbols.count(symbol) == 0)
      return "the report needs a value of the symbol '" + symbol + "': --symbol " + symbol + "=256";
  for (const auto& [symbol, value] : symbols)
    if (std::find(bundle.symbols.begin(), bundle.symbols.end(), symbol) == bundle.symbols.end())
      return "the program has no symbol '" + symbol + "'";
  Report out;
  const auto memory = memory_use(bundle, symbols);
  if (!memory) return std::string("with these symbols the program needs more than 2^63 bytes");
  out.memory = *memory;
  for (const auto& shader : bundle.shaders) out.shader_bytes += static_cast<int64_t>(shader->spirv.size()) * 4;
  out.shaders = bundle.shaders.size();
  for (size_t s = 0; s < compiled.schedule.steps.size(); ++s) {
    const StepSchedule& step = compiled.schedule.steps[s];
    StepReport r;
    r.name = step.name;
    std::set<ir::OpId> computed;
    for (const Pass& pass : step.passes) {
      ++r.passes[kind_name(pass)];
      if (const auto* map = pass.as<MapPass>(); map && map->block) {
        const Block& block = *map->block;
        r.blocks.push_back({pass.name, block.each, block.together ? block.together->group : std::array<int, 3>{}});
      }
      for (ir::OpId id : pass.ops) {
        if (is_inline(graph.op(id)) || is_memory(graph.op(id))) continue;
        if (!computed.insert(id).second) ++r.recomputed;
      }
    }
    r.ops = computed.size();
    r.commands = bundle.steps[s]->commands.size();
    r.first = run_report(graph, compiled, s, profile, symbols, false);
    r.steady = run_report(graph, compiled, s, profile, symbols, true);
    out.steps.push_back(std::move(r));
  }
  out.skips = left_out_of_graph(graph, left_out);
  // What the bundle does not share it needs as a whole.
  out.skips.push_back({"slots", "bytes", out.memory.planned, out.memory.unshared - out.memory.planned});
  SkipCount cache{"cache", "commands", 0, 0};
  for (const auto& step : bundle.steps)
    for (const auto& command : step->commands) ++(command->steady ? cache.done : cache.avoided);
  out.skips.push_back(cache);
  return out;
}

namespace {

std::string bytes_text(const RunReport& run) {
  return std::to_string(run.bytes_read + run.bytes_written) + " (" + std::to_string(run.bytes_read) + " read, " +
         std::to_string(run.bytes_written) + " written)";
}

std::string box_text(const std::array<int, 3>& box) {
  return std::to_string(box[0]) + " x " + std::to_string(box[1]) + (box[2] > 1 ? " x " + std::to_string(box[2]) : "");
}

std::string blocks_text(const std::vector<BlockReport>& blocks) {
  std::string out;
  for (const BlockReport& b : blocks) {
    out += (out.empty() ? "" : ", ") + b.pass + " " + box_text(b.each);
    if (b.group[0] > 0) out += " read together by " + box_text(b.group);
  }
  return out;
}

nlohmann::ordered_json blocks_json(const std::vector<BlockReport>& blocks) {
  auto out = nlohmann::ordered_json::array();
  for (const BlockReport& b : blocks)
    out.push_back({{"pass", b.pass}, {"each", b.each}, {"read_together_by", b.group}});
  return out;
}

nlohmann::ordered_json run_json(const RunReport& run) {
  return {{"passes", run.passes},
          {"stages", run.stages},
          {"expected_ns", run.expected_ns},
          {"bytes_read", run.bytes_read},
          {"bytes_written", run.bytes_written},
          {"least_stages", run.least.stages},
          {"least_bytes", run.least.bytes}};
}

}  // namespace

std::string print(const Report& report) {
  std::string out;
  for (const StepReport& step : report.steps) {
    std::string kinds;
    for (const auto& [kind, n] : step.passes) kinds += (kinds.empty() ? "" : ", ") + std::to_string(n) + " " + kind;
    out += ir::step_title(step.name) + ": " + std::to_string(step.ops) + " ops in " +
           std::to_string(step.first.passes) + " passes (" + kinds + ") in " + std::to_string(step.first.stages) +
           " stages, " + std::to_string(step.commands) + " commands\n";
    char expected[64];
    std::snprintf(expected, sizeof expected, "  expected time: %.3f ms\n", step.first.expected_ns * 1e-6);
    out += expected;
    out += "  recomputed ops: " + std::to_string(step.recomputed) + "\n";
    if (!step.blocks.empty()) out += "  blocks of elements: " + blocks_text(step.blocks) + "\n";
    out += "  bytes moved: " + bytes_text(step.first) + "\n";
    out += "  at least: " + std::to_string(step.first.least.stages) + " stages, " +
           std::to_string(step.first.least.bytes) + " bytes\n";
    std::snprintf(expected, sizeof expected, "%.3f ms", step.steady.expected_ns * 1e-6);
    out += "  after the first run: " + std::to_string(step.steady.passes) + " passes in " +
           std::to_string(step.steady.stages) + " stages, " + expected + ", bytes moved " + bytes_text(step.steady) +
           ", at least " + std::to_string(step.steady.least.stages) + " stages, " +
           std::to_string(step.steady.least.bytes) + " bytes\n";
  }
  const MemoryUse& m = report.memory;
  out += "memory: " + std::to_string(m.planned) + " bytes, " + std::to_string(m.lower_bound) + " needed at least, " +
         std::to_string(m.unshared) + " without sharing, " + std::to_string(m.persistent) + " for leaves and outputs\n";
  out += "left out:";
  for (const SkipCount& skip : report.skips)
    out += std::string(&skip == report.skips.data() ? " " : ", ") + skip.id + " " + std::to_string(skip.avoided) + " " +
           skip.unit + " of " + std::to_string(skip.done + skip.avoided);
  out += "\n";
  out +=
      "shaders: " + std::to_string(report.shaders) + ", " + std::to_string(report.shader_bytes) + " bytes of SPIR-V\n";
  return out;
}

std::string print_json(const Report& report) {
  nlohmann::ordered_json root;
  root["steps"] = nlohmann::ordered_json::array();
  for (const StepReport& step : report.steps)
    root["steps"].push_back({{"name", step.name},
                             {"ops", step.ops},
                             {"passes", step.passes},
                             {"stages", step.first.stages},
                             {"expected_ns", step.first.expected_ns},
                             {"commands", step.commands},
                             {"recomputed_ops", step.recomputed},
                             {"blocks", blocks_json(step.blocks)},
                             {"bytes_read", step.first.bytes_read},
                             {"bytes_written", step.first.bytes_written},
                             {"least_stages", step.first.least.stages},
                             {"least_bytes", step.first.least.bytes},
                             {"after_the_first_run", run_json(step.steady)}});
  root["memory"] = {{"planned", report.memory.planned},
                    {"lower_bound", report.memory.lower_bound},
                    {"unshared", report.memory.unshared},
                    {"persistent", report.memory.persistent}};
  for (const SkipCount& skip : report.skips)
    root["skips"][skip.id] = {{"unit", skip.unit}, {"done", skip.done}, {"avoided", skip.avoided}};
  root["shaders"] = {{"count", report.shaders}, {"spirv_bytes", report.shader_bytes}};
  return root.dump(2) + "\n";
}

}  // namespace dr::backend
