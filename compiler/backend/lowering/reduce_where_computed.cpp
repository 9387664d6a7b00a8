// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/reduce_where_computed.h"

#include <algorithm>
#include <optional>
#include <set>

#include "compiler/backend/schedule/limits.h"

namespace dr::backend {

using ir::ValueId;

namespace {

// The place of the map that computes what a reduction folds, for it alone.
std::optional<size_t> map_of(const ir::Graph& graph, const target::Profile& profile, const Schedule& schedule,
                             const StepSchedule& step, const Pass& reduction) {
  if (!reduction.is<ReducePass>() || reduction.ops.size() != 1 || !reduction.domain.h.is_one()) return std::nullopt;
  const ValueId folded = graph.op(reduction.ops[0]).operands[0];
  const auto reads = [&](const Pass& pass) { return std::ranges::count(pass.reads, folded) > 0; };
  if (std::ranges::count_if(step.passes, reads) != 1 || read_afterwards(graph, step).contains(folded))
    return std::nullopt;
  for (size_t k = 0; k < step.passes.size(); ++k) {
    const Pass& map = step.passes[k];
    if (!map.is<MapPass>() || map.writes != std::vector{folded} || map.domain != reduction.domain) continue;
    const bool plain =
        map.steady == reduction.steady &&
        std::ranges::all_of(map.ops, [&](ir::OpId id) { return graph.op(id).regions.empty(); }) &&
        fits(profile, bindings_of(schedule.resources, resources_of(step, map.reads), reduction.writes.size()));
    return plain ? std::optional(k) : std::nullopt;
  }
  return std::nullopt;
}

}  // namespace

void reduce_where_computed(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule) {
  std::set<uint32_t> unused;
  for (StepSchedule& step : schedule.steps)
    for (size_t k = 0; k < step.passes.size(); ++k) {
      const auto at = map_of(graph, profile, schedule, step, step.passes[k]);
      if (!at) continue;
      Pass& reduction = step.passes[k];
      const Pass& map = step.passes[*at];
      const ValueId folded = map.writes[0];
      reduction.ops.insert(reduction.ops.begin(), map.ops.begin(), map.ops.end());
      reduction.reads = map.reads;
      unused.insert(step.stored.at(folded).index);
      step.stored.erase(folded);
      step.passes.erase(step.passes.begin() + static_cast<ptrdiff_t>(*at));
      if (*at < k) --k;
    }
  remove_resources(schedule, std::move(unused));
}

}  // namespace dr::backend
