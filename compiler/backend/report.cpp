// SPDX-License-Identifier: Apache-2.0
// Counting what a compiled program does.
#include "compiler/backend/report.h"

#include <algorithm>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <set>

#include "compiler/backend/cost.h"
#include "compiler/backend/dependencies.h"
#include "compiler/backend/uses.h"

namespace dr::backend {

std::variant<Report, std::string> report(const ir::Graph& graph, const Compiled& compiled,
                                         const target::Profile& profile, const ir::SymbolValues& symbols) {
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
      for (ir::OpId id : pass.ops) {
        if (is_inline(graph.op(id)) || is_memory(graph.op(id))) continue;
        if (!computed.insert(id).second) ++r.recomputed;
      }
    }
    r.ops = computed.size();
    r.stages = step.passes.empty() ? 0 : step.passes.back().stage + 1;
    r.expected_ns = step_cost(graph, compiled.schedule, step, profile, symbols).value_or(0);
    r.commands = bundle.steps[s]->commands.size();
    for (const auto& command : bundle.steps[s]->commands)
      for_each_access(*command, [&](uint32_t resource, bundle::Access access) {
        const int64_t bytes = *resource_bytes(*bundle.resources[resource], symbols);
        if (access != bundle::Access::Write) r.bytes_read += bytes;
        if (access != bundle::Access::Read) r.bytes_written += bytes;
      });
    out.steps.push_back(std::move(r));
  }
  return out;
}

namespace {

size_t pass_count(const StepReport& step) {
  size_t count = 0;
  for (const auto& [kind, n] : step.passes) count += n;
  return count;
}

}  // namespace

std::string print(const Report& report) {
  std::string out;
  for (const StepReport& step : report.steps) {
    std::string kinds;
    for (const auto& [kind, n] : step.passes) kinds += (kinds.empty() ? "" : ", ") + std::to_string(n) + " " + kind;
    out += "step " + step.name + ": " + std::to_string(step.ops) + " ops in " + std::to_string(pass_count(step)) +
           " passes (" + kinds + ") in " + std::to_string(step.stages) + " stages, " + std::to_string(step.commands) +
           " commands\n";
    char expected[64];
    std::snprintf(expected, sizeof expected, "  expected time: %.3f ms\n", step.expected_ns * 1e-6);
    out += expected;
    out += "  recomputed ops: " + std::to_string(step.recomputed) + "\n";
    out += "  bytes moved: " + std::to_string(step.bytes_read + step.bytes_written) + " (" +
           std::to_string(step.bytes_read) + " read, " + std::to_string(step.bytes_written) + " written)\n";
  }
  const MemoryUse& m = report.memory;
  out += "memory: " + std::to_string(m.planned) + " bytes, " + std::to_string(m.lower_bound) + " needed at least, " +
         std::to_string(m.unshared) + " without sharing, " + std::to_string(m.persistent) + " for leaves and outputs\n";
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
                             {"stages", step.stages},
                             {"expected_ns", step.expected_ns},
                             {"commands", step.commands},
                             {"recomputed_ops", step.recomputed},
                             {"bytes_read", step.bytes_read},
                             {"bytes_written", step.bytes_written}});
  root["memory"] = {{"planned", report.memory.planned},
                    {"lower_bound", report.memory.lower_bound},
                    {"unshared", report.memory.unshared},
                    {"persistent", report.memory.persistent}};
  root["shaders"] = {{"count", report.shaders}, {"spirv_bytes", report.shader_bytes}};
  return root.dump(2) + "\n";
}

}  // namespace dr::backend
