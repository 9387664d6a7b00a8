// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/clear_by_epochs.h"

namespace dr::backend {

void clear_by_epochs(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule) {
  // The clear has to be a dispatch.
  if (!profile.is_gpu() || !schedule.code.wide_words || schedule.code.clears == 0) return;
  for (StepSchedule& step : schedule.steps)
    for (const Pass& pass : step.passes) {
      if (!pass.is<RasterPass>()) continue;
      Resource& r = schedule.resources[step.stored.at(graph.op(pass.ops.back()).results[0]).index];
      if (r.is(Resource::Storage::Entries)) r.storage = Resource::Storage::EpochEntries;
    }
}

}  // namespace dr::backend
