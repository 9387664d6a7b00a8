// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/guess_exponents.h"

#include <algorithm>

#include "compiler/backend/analysis/shared_loops.h"
#include "compiler/backend/lowering/scatter_costs.h"
#include "compiler/backend/schedule/limits.h"
#include "compiler/backend/schedule/trips.h"

namespace dr::backend {

using ir::ValueId;

namespace {

// Whether the map that lists what a scatter adds may add by a guess, and few invocations take the second run.
bool may_guess_where_listed(const ir::Graph& graph, const target::Profile& profile, const Schedule& schedule,
                            const StepSchedule& step, const Pass& scatter) {
  Bindings bindings = joined_bindings(schedule.resources, step, scatter);
  bindings.more += static_cast<uint32_t>(scatter.get<ScatterPass>().sums.size()) + (asks_for_guesses(profile) ? 1 : 0);
  return !needs_cut(trips_of(graph, scatter.ops), profile, kElementsOfGuess) && fits(profile, bindings);
}

}  // namespace

bool asks_for_guesses(const target::Profile& profile) { return profile.lanes_in_turn; }

bool guesses_have_room(const target::Profile& profile, const Schedule& schedule, const StepSchedule& step) {
  return std::ranges::all_of(step.passes, [&](const Pass& pass) {
    const size_t guesses = guesses_bound(schedule.resources, step, pass);
    Bindings bindings =
        bindings_of(schedule.resources, resources_of(step, pass.reads), pass.writes.size(), pass.is_drawn());
    bindings.more += static_cast<uint32_t>(guesses) + kScatterBuffers;
    return guesses == 0 || fits(profile, bindings);
  });
}

void guess_exponents(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule) {
  for (StepSchedule& step : schedule.steps)
    for (Pass& pass : step.passes) {
      auto* scatter = pass.as<ScatterPass>();
      // What runs once guesses nothing.
      if (scatter == nullptr || !pass.steady || !may_guess(graph, schedule.resources, step, pass)) continue;
      ExactScatter& exact = *scatter->exact();
      if (exact.guesses) continue;  // see add_where_computed.h
      auto* joined = std::get_if<JoinedFirstRun>(&exact.first_run);
      if (!are_cached(graph, scatter->sums) || !(profile.is_gpu() || (joined != nullptr && profile.lanes_in_turn)))
        continue;
      if (joined != nullptr && !may_guess_where_listed(graph, profile, schedule, step, pass)) continue;
      exact.guesses = true;
      if (!guesses_have_room(profile, schedule, step)) {
        exact.guesses = false;
      } else if (joined != nullptr) {
        joined->keeps_terms = false;
        joined->asks = asks_for_guesses(profile);
        exact.joins_pairs = false;
        exact.joins_groups = groups_may_join(graph, profile, step, pass);
      } else {
        auto& own = std::get<OwnFirstRun>(exact.first_run);
        own.relists = false;
        own.nonzero.clear();
        exact.shares_loops = scatter->active_list() != nullptr && have_loop_that_only_scatters(graph, pass.ops) &&
                             !needs_cut(trips_of(graph, pass.ops), profile);
      }
    }
}

}  // namespace dr::backend
