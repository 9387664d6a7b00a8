// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/clear_where_listed.h"

#include "compiler/backend/schedule/limits.h"

namespace dr::backend {

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
        if (!by) continue;
        Bindings all = listing_bindings(schedule.resources, step, *by);
        all.more += 1;  // the sum
        if (fits(profile, all)) r.storage = Resource::Storage::ListedSums;
      }
    }
}

}  // namespace dr::backend
