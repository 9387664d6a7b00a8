// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/recompute_second_run.h"

#include <algorithm>
#include <map>
#include <set>

#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/lowering/heavy_branches.h"
#include "compiler/backend/schedule/limits.h"
#include "compiler/backend/schedule/trips.h"

namespace dr::backend {

using ir::OpId;
using ir::ValueId;

namespace {

// What the second run needs if it does all that its sums are made of.
struct Whole {
  std::vector<OpId> ops;
  std::vector<ValueId> reads;
};

Whole whole_of(const ir::Graph& graph, const Pass& lister, const Pass& scatter) {
  std::set<OpId> all(lister.ops.begin(), lister.ops.end());
  all.insert(scatter.ops.begin(), scatter.ops.end());
  std::vector<OpId> order;
  for (const OpId id : graph.region(graph.root()).ops)
    if (all.count(id) != 0) order.push_back(id);
  Whole out;
  out.ops = ops_of(graph, order, scatter.writes);
  std::set<ValueId> computed, reads;
  for (const OpId id : out.ops) {
    const Uses uses = uses_of(graph, graph.op(id));
    for (const auto* list : {&uses.at_element, &uses.elsewhere})
      for (const ValueId v : *list)
        if (computed.count(v) == 0 && (contains(lister.reads, v) || contains(scatter.reads, v))) reads.insert(v);
    computed.insert(graph.op(id).results.begin(), graph.op(id).results.end());
  }
  out.reads.assign(reads.begin(), reads.end());
  return out;
}

// Whether memory is what the lister found until the second run is done with it.
bool stays(const Schedule& schedule, const StepSchedule& step, const Pass& lister, const Pass& scatter, ValueId v) {
  const ResourceId at = step.stored.at(v);
  if (schedule.resources[at.index].is_sums()) return false;
  const size_t from = static_cast<size_t>(&lister - step.passes.data());
  for (size_t k = from; k < step.passes.size() && step.passes[k].stage <= scatter.stage; ++k)
    if (std::ranges::any_of(step.passes[k].writes, [&](ValueId w) { return step.stored.at(w).index == at.index; }))
      return false;
  return true;
}

bool may_recompute(const ir::Graph& graph, const target::Profile& profile, const Schedule& schedule,
                   const StepSchedule& step, const Pass& lister, const Pass& scatter, const Whole& whole) {
  if (needs_cut(trips_of(graph, lister.ops) + trips_of(graph, scatter.ops), profile, kElementsOfGuess)) return false;
  // The lister's own results are there, or are made again.
  if (std::ranges::any_of(whole.reads, [&](ValueId v) { return !stays(schedule, step, lister, scatter, v); }))
    return false;
  Bindings bindings = bindings_of(schedule.resources, resources_of(step, whole.reads), scatter.writes.size());
  bindings.more = static_cast<uint32_t>(scatter.get<ScatterPass>().sums.size());
  return fits(profile, bindings);
}

}  // namespace

bool compute_again(const ir::Graph& graph, const target::Profile& profile, const Schedule& schedule, StepSchedule& step,
                   Pass& scatter, std::set<uint32_t>& unused) {
  Pass& lister = step.pass(*scatter.lister());
  Whole whole = whole_of(graph, lister, scatter);
  if (!may_recompute(graph, profile, schedule, step, lister, scatter, whole)) return false;
  scatter.ops = std::move(whole.ops);
  scatter.reads = std::move(whole.reads);
  std::get<JoinedFirstRun>(scatter.get<ScatterPass>().exact()->first_run).again = true;
  const std::set<ValueId> kept = read_afterwards(graph, step);
  std::vector<ValueId>& partial = lister.get<MapPass>().partial;
  const auto is_needless = [&](ValueId v) {
    return kept.count(v) == 0 &&
           std::ranges::none_of(step.passes, [&](const Pass& pass) { return contains(pass.reads, v); });
  };
  for (const ValueId v : lister.writes)
    if (is_needless(v)) {
      unused.insert(step.stored.at(v).index);
      step.stored.erase(v);
    }
  std::erase_if(lister.writes, is_needless);
  std::erase_if(partial, [&](ValueId v) { return !contains(lister.writes, v); });
  return true;
}

void recompute_second_run(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule) {
  std::set<uint32_t> unused;
  for (StepSchedule& step : schedule.steps)
    for (Pass& scatter : step.passes) {
      const auto* sums = scatter.as<ScatterPass>();
      if (sums == nullptr || !sums->guesses() || sums->joined_run() == nullptr || sums->runs_again()) continue;
      const Pass& lister = step.pass(*sums->lister());
      const bool heavy = !heavy_branches(graph, lister, trips_of(graph, lister.ops), profile).empty();
      if (sums->joins_groups() || heavy) compute_again(graph, profile, schedule, step, scatter, unused);
    }
  remove_resources(schedule, std::move(unused));
}

}  // namespace dr::backend
