// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/empty_sums.h"

#include <algorithm>

#include "compiler/backend/schedule/limits.h"

namespace dr::backend {

void empty_sums(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule) {
  if (!profile.is_gpu()) return;
  for (StepSchedule& step : schedule.steps)
    for (const Pass& pass : step.passes) {
      const auto* scatter = pass.as<ScatterPass>();
      if (scatter == nullptr) continue;
      for (const ScatterSum& sum : scatter->sums) {
        Resource& r = schedule.resources[step.stored.at(sum.value).index];
        if (r.is(Resource::Storage::Sums) && may_empty(graph, step, pass, sum))
          r.storage = Resource::Storage::EmptiedSums;
        else if (may_empty_floats(graph, schedule.resources, step, pass, sum))
          r.storage = Resource::Storage::Emptied;
      }
    }
}

}  // namespace dr::backend
