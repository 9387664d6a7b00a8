// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/update_in_place.h"

#include <algorithm>
#include <set>

#include "compiler/backend/analysis/uses.h"

namespace dr::backend {

using ir::ValueId;

namespace {

// Whether the value of an update may be written into its leaf.
bool may_overwrite(const ir::Graph& graph, const Schedule& schedule, const StepSchedule& step, uint32_t leaf,
                   ValueId value) {
  const Resource& from = schedule.resources[step.stored.at(value).index];
  const Resource& to = schedule.resources[leaf];
  if (is_memory(graph.op(graph.value(value).op)) || !from.is_buffer() || from.is(Resource::Storage::Leaf) ||
      from.type != to.type || from.extent != to.extent)
    return false;
  auto is_old = [&](ValueId v) {
    const auto it = step.stored.find(v);
    return it != step.stored.end() && it->second.index == leaf;
  };
  for (const auto& [name, v] : step.outputs)
    if (v == value || is_old(v)) return false;
  for (const auto& [other, v] : step.updates)
    if (other != leaf && (v == value || is_old(v))) return false;
  bool written = false;
  for (const Pass& pass : step.passes) {
    const bool writes = std::find(pass.writes.begin(), pass.writes.end(), value) != pass.writes.end();
    if (written && (writes || std::any_of(pass.reads.begin(), pass.reads.end(), is_old))) return false;
    if (!writes) continue;
    written = true;
    if (!pass.is<MapPass>() || pass.domain != to.extent) return false;
    for (ir::OpId id : pass.ops) {
      const Uses uses = uses_of(graph, graph.op(id));
      if (std::any_of(uses.elsewhere.begin(), uses.elsewhere.end(), is_old)) return false;
    }
  }
  return written;
}

}  // namespace

void update_in_place(const ir::Graph& graph, Schedule& schedule) {
  std::set<uint32_t> unused;
  for (StepSchedule& step : schedule.steps)
    for (const auto& [leaf, value] : step.updates) {
      if (!may_overwrite(graph, schedule, step, leaf, value)) continue;
      const uint32_t own = step.stored.at(value).index;
      step.stored.at(value) = ResourceId{leaf};
      unused.insert(own);
    }
  remove_resources(schedule, std::move(unused));
}

}  // namespace dr::backend
