// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/add_where_computed.h"

#include <algorithm>
#include <map>
#include <optional>
#include <set>

#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/lowering/guess_exponents.h"
#include "compiler/backend/lowering/recompute_second_run.h"
#include "compiler/backend/lowering/scatter_active.h"
#include "compiler/backend/lowering/scatter_costs.h"
#include "compiler/backend/lowering/unite_passes.h"
#include "compiler/backend/schedule/limits.h"

namespace dr::backend {

using ir::ValueId;

namespace {

// The map that may add what a pass scatters: it computes all that decides whether an element adds something.
std::optional<PassId> map_of(const ir::Graph& graph, const Schedule& schedule, const StepSchedule& step, size_t k) {
  const Pass& pass = step.passes[k];
  const auto* scatter = pass.as<ScatterPass>();
  if (scatter == nullptr || scatter->exact() == nullptr || !scatter->clauses().empty() || !pass.steady ||
      !adds_everywhere(graph, pass) || !may_guess(graph, schedule.resources, step, pass))
    return std::nullopt;
  const Clauses clauses = active_elements(graph, pass);
  const auto map = clauses.empty() ? std::nullopt : find_lister(graph, step, k, clauses);
  return map && step.pass(*map).steady && is_computed_by_then(graph, step, *map, pass) ? map : std::nullopt;
}

// The step where the map adds what a group of passes scatters, if it may.
std::optional<StepSchedule> with_added(const ir::Graph& graph, const target::Profile& profile, const Schedule& schedule,
                                       StepSchedule step, PassId map, const std::set<size_t>& group,
                                       std::set<uint32_t>& unused) {
  put_in_place_of(group, united(graph, step, group), step);
  Pass& scatter = step.passes[*group.begin()];
  auto& sums = scatter.get<ScatterPass>();
  if (!are_cached(graph, sums.sums)) return std::nullopt;
  sums.exact()->first_run =
      JoinedFirstRun{{active_elements(graph, scatter), map}, false, false, asks_for_guesses(profile)};
  sums.exact()->guesses = true;
  sums.exact()->joins_runs = lanes_in_runs(profile);
  std::set<uint32_t> needless;
  if (!compute_again(graph, profile, schedule, step, scatter, needless) || !guesses_have_room(profile, schedule, step))
    return std::nullopt;
  Bindings bindings = joined_bindings(schedule.resources, step, scatter);
  bindings.more += lists_bound(1) - 1;  // it may list heavy elements, too
  if (!fits(profile, bindings)) return std::nullopt;
  unused.merge(needless);
  return step;
}

// Takes passes away that became parts of others.
void remove_empty(StepSchedule& step) {
  std::vector<PassId> now(step.passes.size());
  size_t count = 0;
  for (size_t k = 0; k < now.size(); ++k) {
    now[k] = pass_id(count);
    count += step.passes[k].ops.empty() ? 0 : 1;
  }
  std::erase_if(step.passes, [](const Pass& pass) { return pass.ops.empty(); });
  for (Pass& pass : step.passes)
    if (auto* scatter = pass.as<ScatterPass>(); scatter != nullptr && scatter->runs_again()) {
      PassId& map = std::get<JoinedFirstRun>(scatter->exact()->first_run).lister;
      map = now[map.index];
    }
}

}  // namespace

void add_where_computed(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule) {
  if (!profile.lanes_in_turn) return;
  std::set<uint32_t> unused;
  for (StepSchedule& step : schedule.steps) {
    std::map<PassId, std::set<size_t>> groups;
    for (size_t k = 0; k < step.passes.size(); ++k)
      if (const auto map = map_of(graph, schedule, step, k)) groups[*map].insert(k);
    for (const auto& [map, group] : groups)
      if (auto with = with_added(graph, profile, schedule, step, map, group, unused)) step = std::move(*with);
    remove_empty(step);
  }
  remove_resources(schedule, std::move(unused));
}

}  // namespace dr::backend
