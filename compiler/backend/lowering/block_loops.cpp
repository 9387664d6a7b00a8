// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/block_loops.h"

#include "compiler/backend/cost/blocks.h"
#include "compiler/backend/lowering/heavy_branches.h"
#include "compiler/backend/schedule/trips.h"

namespace dr::backend {

void block_loops(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule) {
  BlockChooser chooser(graph, profile);
  for (StepSchedule& step : schedule.steps) {
    for (size_t k = 0; k < step.passes.size(); ++k) {
      Pass& pass = step.passes[k];
      auto* map = pass.as<MapPass>();
      if (map == nullptr || !map->partial.empty()) continue;
      // What those compute is listed, or goes into another's shader.
      if (!listed_for(step, pass_id(k)).empty() || set_up_for(step, pass_id(k)) != nullptr) continue;
      // Those run for the elements that take them alone.
      if (!heavy_branches(graph, pass, trips_of(graph, pass.ops), profile).empty()) continue;
      map->block = chooser.choose(pass);
    }
  }
}

}  // namespace dr::backend
