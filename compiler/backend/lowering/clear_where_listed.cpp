// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/clear_where_listed.h"

#include <algorithm>

#include "compiler/backend/schedule/limits.h"

namespace dr::backend {

namespace {

// Whether the shader of a map has room for the sums that it clears.
bool has_room(const target::Profile& profile, const Schedule& schedule, const StepSchedule& step, PassId id) {
  const Pass& map = step.pass(id);
  Bindings all = bindings_of(schedule.resources, resources_of(step, map.reads), map.writes.size());
  const std::vector<const Pass*> scatters = listed_for(step, id);
  for (const Pass* scatter : scatters)
    if (scatter->get<ScatterPass>().joined_run() != nullptr) all = joined_bindings(schedule.resources, step, *scatter);
  all.more += lists_bound(scatters.size()) + cleared_bound(schedule.resources, step, id) + 1;
  return fits(profile, all);
}

}  // namespace

void clear_where_listed(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule) {
  if (!profile.lanes_in_turn) return;
  for (StepSchedule& step : schedule.steps)
    for (const Pass& pass : step.passes) {
      const auto* scatter = pass.as<ScatterPass>();
      if (scatter == nullptr) continue;
      for (const ScatterSum& sum : scatter->sums) {
        Resource& r = schedule.resources[step.stored.at(sum.value).index];
        if (!r.is(Resource::Storage::Sums)) continue;
        const auto by = may_clear_where_listed(graph, step, pass, sum);
        if (by && has_room(profile, schedule, step, *by)) r.storage = Resource::Storage::ListedSums;
      }
    }
}

}  // namespace dr::backend
