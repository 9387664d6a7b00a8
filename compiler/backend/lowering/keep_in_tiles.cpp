// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/keep_in_tiles.h"

#include <map>
#include <set>

namespace dr::backend {

using ir::ValueId;

void keep_in_tiles(const ir::Graph& graph, Schedule& schedule) {
  for (const StepSchedule& step : schedule.steps) {
    std::map<ValueId, uint32_t> stage_of;
    std::set<ValueId> stored = read_afterwards(graph, step);
    for (const Pass& pass : step.passes) {
      for (ValueId v : pass.reads)
        if (const auto it = stage_of.find(v); it != stage_of.end() && it->second != pass.stage) stored.insert(v);
      const bool fragment = pass.is<FragmentPass>();
      for (ValueId v : pass.writes)
        if (!fragment || !stage_of.try_emplace(v, pass.stage).second) stored.insert(v);
    }
    for (const auto& [v, stage] : stage_of) {
      Resource& resource = schedule.resources[step.stored.at(v).index];
      if (stored.count(v) == 0 && resource.is(Resource::Storage::Image)) resource.storage = Resource::Storage::Tile;
    }
  }
}

}  // namespace dr::backend
