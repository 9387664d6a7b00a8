// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/raster_entries.h"

#include <algorithm>

#include "compiler/backend/analysis/raster_parts.h"

namespace dr::backend {

using ir::ValueId;

void keep_entries(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule) {
  std::set<uint32_t> unused;
  for (StepSchedule& step : schedule.steps) {
    const std::set<ValueId> kept = read_afterwards(graph, step);
    for (Pass& pass : step.passes) {
      auto* raster = pass.as<RasterPass>();
      if (raster == nullptr) continue;
      const ir::Op& op = graph.op(pass.ops.back());
      const std::vector<ValueId>& results = op.results;
      if (results.size() == 1) continue;  // faces are listed: what the walk leaves is the result
      if (std::ranges::any_of(results, [&](ValueId v) { return kept.count(v) != 0; })) continue;
      const ResourceId id = step.stored.at(results[0]);
      Resource& entries = schedule.resources[id.index];
      raster->presence = profile.lanes_in_turn && is_asked_for_presence(graph, op);
      if (raster->presence) {
        entries.storage = Resource::Storage::Buffer;
      } else {
        entries.name += "_entries";
        entries.storage = Resource::Storage::Entries;
        entries.type = ir::vec(2, ir::Scalar::Uint);
        entries.extent.l = entries.extent.l * ir::Dim(static_cast<int64_t>(results.size() / 2));
      }
      for (size_t k = 1; k < results.size(); ++k) {
        unused.insert(step.stored.at(results[k]).index);
        step.stored.at(results[k]) = id;
      }
    }
  }
  remove_resources(schedule, std::move(unused));
}

}  // namespace dr::backend
