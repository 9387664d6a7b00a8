// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/clear_by_epochs.h"

namespace dr::backend {

bool may_have_epochs(const Schedule& schedule, const RasterPass& raster) {
  return schedule.code.wide_words && schedule.code.clears > 0 && !raster.presence;
}

void clear_by_epochs(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule) {
  if (!profile.is_gpu()) return;
  for (StepSchedule& step : schedule.steps)
    for (const Pass& pass : step.passes) {
      const auto* raster = pass.as<RasterPass>();
      if (raster == nullptr || !may_have_epochs(schedule, *raster)) continue;
      Resource& r = schedule.resources[step.stored.at(graph.op(pass.ops.back()).results[0]).index];
      if (r.is(Resource::Storage::Entries)) r.storage = Resource::Storage::EpochEntries;
    }
}

}  // namespace dr::backend
