// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/raster_entries.h"

#include <algorithm>

namespace dr::backend {

using ir::ValueId;

void keep_entries(const ir::Graph& graph, Schedule& schedule) {
  std::set<uint32_t> unused;
  for (StepSchedule& step : schedule.steps) {
    const std::set<ValueId> kept = read_afterwards(graph, step);
    for (const Pass& pass : step.passes) {
      if (!pass.is<RasterPass>()) continue;
      const std::vector<ValueId>& results = graph.op(pass.ops.back()).results;
      if (results.size() == 1) continue;  // faces are listed: what the walk leaves is the result
      if (std::ranges::any_of(results, [&](ValueId v) { return kept.count(v) != 0; })) continue;
      const ResourceId id = step.stored.at(results[0]);
      Resource& entries = schedule.resources[id.index];
      entries.name += "_entries";
      entries.storage = Resource::Storage::Entries;
      entries.type = ir::vec(2, ir::Scalar::Uint);
      entries.extent.l = entries.extent.l * ir::Dim(static_cast<int64_t>(results.size() / 2));
      for (size_t k = 1; k < results.size(); ++k) {
        unused.insert(step.stored.at(results[k]).index);
        step.stored.at(results[k]) = id;
      }
    }
  }
  remove_resources(schedule, std::move(unused));
}

}  // namespace dr::backend
