// SPDX-License-Identifier: Apache-2.0
#include "runtime/drun/counters.h"

#include <algorithm>
#include <cstdio>
#include <nlohmann/json.hpp>

namespace dr::drun {

namespace {

using nlohmann::ordered_json;

// "commands 5 run, 3 left out (38%)".
std::string part(const std::string& what, const char* verb, int64_t run, int64_t skipped) {
  const double share =
      run + skipped > 0 ? 100.0 * static_cast<double>(skipped) / static_cast<double>(run + skipped) : 0;
  char text[256];
  std::snprintf(text, sizeof text, "%s %lld %s, %lld left out (%.0f%%)", what.c_str(), static_cast<long long>(run),
                verb, static_cast<long long>(skipped), share);
  return text;
}

std::string work_line(const std::string& step, const runtime::StepCounters& c) {
  return step + ": " + std::to_string(c.runs) + (c.runs == 1 ? " run" : " runs") + "  " +
         part("commands", "run", c.run.commands, c.skipped.commands) + "  " +
         part("ops", "run", c.run.ops, c.skipped.ops) + "  " + part("bytes", "run", c.run.bytes, c.skipped.bytes) +
         "\n";
}

// Runs whose commands were recorded for them, and those that took recorded ones.
jit::Skip recorded(const runtime::StepCounters& c) { return {"commands", "runs", c.recorded, c.runs - c.recorded}; }

jit::Skip kept(const runtime::PipelineCounters& p) { return {"pipelines", "pipelines", p.made - p.kept, p.kept}; }

std::string memory_line(const runtime::MemoryUse& use) {
  std::string out = "memory: " + std::to_string(use.device) + " bytes of the device and " + std::to_string(use.host) +
                    " of the host, " + std::to_string(use.peak) + " at most";
  for (size_t k = 0; k < use.host_leaves.size(); ++k)
    out += (k == 0 ? "; the device reads from the host's: " : ", ") + use.host_leaves[k];
  return out + "\n";
}

ordered_json json_of(const jit::Skip& s) { return {{"unit", s.unit}, {"done", s.done}, {"avoided", s.avoided}}; }

}  // namespace

std::vector<jit::Skip> lists_of(const std::vector<runtime::CommandTime>& commands) {
  std::map<std::string, jit::Skip> lists;
  for (const runtime::CommandTime& c : commands) {
    if (c.list.empty()) continue;
    jit::Skip& list = lists.try_emplace(c.list, jit::Skip{c.list, "elements", 0, 0}).first->second;
    list.done += c.listed;
    list.avoided += c.elements - c.listed;
  }
  std::vector<jit::Skip> out;
  for (auto& [name, list] : lists) out.push_back(std::move(list));
  return out;
}

std::string print(const Counters& counters) {
  std::string out;
  for (const auto& [step, c] : counters.steps) {
    out += work_line(step, c.work);
    const jit::Skip again = recorded(c.work);
    out += "  " + part("runs", "recorded", again.done, again.avoided) + "\n";
    for (const jit::Skip& list : c.lists)
      out += "  " + part(list.id + " elements of the last run", "listed", list.done, list.avoided) + "\n";
    if (c.fragments > 0) out += "  fragments of the last run " + std::to_string(c.fragments) + "\n";
  }
  for (const jit::Skip& s : counters.compiled)
    out += "compiled: " + part(s.id, s.unit.c_str(), s.done, s.avoided) + "\n";
  const jit::Skip pipelines = kept(counters.pipelines);
  out += part("pipelines", "made", pipelines.done, pipelines.avoided) + "; built anew " +
         std::to_string(counters.rebuilds) + " times\n";
  return out + memory_line(counters.memory);
}

std::string print_json(const Counters& counters) {
  ordered_json root;
  root["steps"] = ordered_json::object();
  for (const auto& [step, c] : counters.steps) {
    ordered_json& to = root["steps"][step];
    to["runs"] = c.work.runs;
    to["skips"]["cache"] = json_of({"cache", "commands", c.work.run.commands, c.work.skipped.commands});
    to["skips"]["cache"]["ops"] = {{"done", c.work.run.ops}, {"avoided", c.work.skipped.ops}};
    to["skips"]["cache"]["bytes"] = {{"done", c.work.run.bytes}, {"avoided", c.work.skipped.bytes}};
    to["skips"]["commands"] = json_of(recorded(c.work));
    to["fragments"] = c.fragments;
    for (const jit::Skip& list : c.lists) to["skips"][list.id] = json_of(list);
  }
  root["skips"] = ordered_json::object();
  for (const jit::Skip& s : counters.compiled) root["skips"][s.id] = json_of(s);
  root["skips"]["pipelines"] = json_of(kept(counters.pipelines));
  root["rebuilds"] = counters.rebuilds;
  root["memory"] = {{"device", counters.memory.device},
                    {"host", counters.memory.host},
                    {"peak", counters.memory.peak},
                    {"host_leaves", counters.memory.host_leaves}};
  return root.dump() + "\n";
}

}  // namespace dr::drun
