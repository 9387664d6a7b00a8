// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/keep_sums.h"

#include <algorithm>

#include "compiler/backend/analysis/named_once.h"
#include "compiler/backend/analysis/uses.h"

namespace dr::backend {

using ir::ValueId;

namespace {

// Whether a pass reads a value of its own extent at its own element and nowhere else.
bool reads_in_place(const ir::Graph& graph, const Pass& pass, ValueId v) {
  return pass.kind() == PassKind::Map && pass.domain == graph.value(v).extent &&
         std::ranges::none_of(pass.ops, [&](ir::OpId id) {
           const Uses uses = uses_of(graph, graph.op(id));
           return std::ranges::find(uses.elsewhere, v) != uses.elsewhere.end();
         });
}

}  // namespace

void keep_sums(const ir::Graph& graph, Schedule& schedule) {
  for (StepSchedule& step : schedule.steps) {
    const std::set<ValueId> kept = read_afterwards(graph, step);
    for (const Pass& pass : step.passes) {
      const auto* scatter = pass.as<ScatterPass>();
      if (scatter == nullptr || (scatter->exact() == nullptr && scatter->binned() == nullptr)) continue;
      for (const ScatterSum& sum : scatter->sums) {
        const ValueId v = sum.value;
        if (!graph.value(v).type.is_float() || kept.count(v) != 0 || named_once(graph, sum.terms)) continue;
        std::vector<const Pass*> readers;
        for (const Pass& other : step.passes)
          if (std::ranges::find(other.reads, v) != other.reads.end()) readers.push_back(&other);
        if (readers.size() == 1 && reads_in_place(graph, *readers[0], v))
          schedule.resources[step.stored.at(v).index].storage = Resource::Storage::Sums;
      }
    }
  }
}

}  // namespace dr::backend
