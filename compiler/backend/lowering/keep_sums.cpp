// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/keep_sums.h"

#include "compiler/backend/analysis/named_once.h"
#include "compiler/backend/schedule/limits.h"

namespace dr::backend {

using ir::ValueId;

void keep_sums(const ir::Graph& graph, Schedule& schedule) {
  for (StepSchedule& step : schedule.steps) {
    for (const Pass& pass : step.passes) {
      const auto* scatter = pass.as<ScatterPass>();
      if (scatter == nullptr || (scatter->exact() == nullptr && scatter->binned() == nullptr)) continue;
      for (const ScatterSum& sum : scatter->sums) {
        const ValueId v = sum.value;
        if (graph.value(v).type.is_float() && !named_once(graph, sum.terms) && is_read_in_place(graph, step, v))
          schedule.resources[step.stored.at(v).index].storage = Resource::Storage::Sums;
      }
    }
  }
}

}  // namespace dr::backend
