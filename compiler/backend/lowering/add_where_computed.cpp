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
#include "compiler/backend/schedule/limits.h"

namespace dr::backend {

using ir::ValueId;

namespace {

// Whether all that the scatter reads is there when the map runs, but for what it reads of the map's own at other
// places.
bool is_there(const ir::Graph& graph, const StepSchedule& step, PassId lister, const Pass& scatter) {
  const std::vector<ValueId>& own = step.pass(lister).writes;
  for (const ir::OpId id : scatter.ops)
    if (std::ranges::any_of(uses_of(graph, graph.op(id)).elsewhere, [&](ValueId v) { return contains(own, v); }))
      return false;
  for (size_t k = lister.index + 1; &step.passes[k] != &scatter; ++k)
    if (std::ranges::any_of(step.passes[k].writes, [&](ValueId v) { return contains(scatter.reads, v); })) return false;
  return true;
}

// Whether the map's shader may bind all sums and their guesses, beside what is still stored.
bool fits_map(const ir::Graph& graph, const target::Profile& profile, const Schedule& schedule,
              const StepSchedule& step, PassId lister, const Pass& scatter) {
  const Pass& map = step.pass(lister);
  const std::set<ValueId> kept = read_afterwards(graph, step);
  const auto stays = [&](ValueId v) {
    return kept.count(v) != 0 || std::ranges::any_of(step.passes, [&](const Pass& pass) {
             return &pass != &scatter && contains(pass.reads, v);
           });
  };
  std::vector<uint32_t> reads = resources_of(step, map.reads);
  for (const uint32_t r : resources_of(step, scatter.reads)) reads.push_back(r);
  Bindings bindings =
      bindings_of(schedule.resources, std::move(reads), static_cast<size_t>(std::ranges::count_if(map.writes, stays)));
  bindings.more = static_cast<uint32_t>(2 * scatter.get<ScatterPass>().sums.size()) + kMapLists;
  return fits(profile, bindings);
}

// The map that may add what a pass scatters: it computes all that decides whether an element adds something.
std::optional<PassId> map_of(const ir::Graph& graph, const Schedule& schedule, const StepSchedule& step, size_t k) {
  const Pass& pass = step.passes[k];
  const auto* scatter = pass.as<ScatterPass>();
  if (scatter == nullptr || scatter->exact() == nullptr || !scatter->clauses().empty() || !pass.steady ||
      !adds_everywhere(graph, pass) || !may_guess(graph, schedule.resources, step, pass))
    return std::nullopt;
  const Clauses clauses = active_elements(graph, pass);
  const auto map = clauses.empty() ? std::nullopt : find_lister(graph, step, k, clauses);
  return map && step.pass(*map).steady && is_there(graph, step, *map, pass) ? map : std::nullopt;
}

// Makes one pass of all of a group, the first, and leaves the others empty.
void unite(const ir::Graph& graph, StepSchedule& step, const std::vector<size_t>& group) {
  std::set<ir::OpId> ops;
  std::set<ValueId> reads, writes;
  std::vector<ScatterSum> sums;
  std::string name;
  for (const size_t k : group) {
    const Pass& pass = step.passes[k];
    ops.insert(pass.ops.begin(), pass.ops.end());
    reads.insert(pass.reads.begin(), pass.reads.end());
    writes.insert(pass.writes.begin(), pass.writes.end());
    const auto& own = pass.get<ScatterPass>().sums;
    sums.insert(sums.end(), own.begin(), own.end());
    name += (name.empty() ? "" : "_") + pass.name;
    if (k != group.front()) step.passes[k] = {};
  }
  std::ranges::sort(sums, {}, &ScatterSum::value);
  Pass& into = step.passes[group.front()];
  into.name = name;
  into.ops.clear();
  for (const ir::OpId id : graph.region(graph.root()).ops)
    if (ops.count(id) != 0) into.ops.push_back(id);
  into.reads.assign(reads.begin(), reads.end());
  into.writes.assign(writes.begin(), writes.end());
  into.get<ScatterPass>().sums = std::move(sums);
}

// The step where the map adds what a group of passes scatters, if it may.
std::optional<StepSchedule> with_added(const ir::Graph& graph, const target::Profile& profile, const Schedule& schedule,
                                       StepSchedule step, PassId map, const std::vector<size_t>& group,
                                       std::set<uint32_t>& unused) {
  unite(graph, step, group);
  Pass& scatter = step.passes[group.front()];
  auto& sums = scatter.get<ScatterPass>();
  if (!are_cached(graph, sums.sums) || !fits_map(graph, profile, schedule, step, map, scatter)) return std::nullopt;
  sums.exact()->first_run = JoinedFirstRun{{active_elements(graph, scatter), map}};
  sums.exact()->guesses = true;
  std::set<uint32_t> needless;
  if (!compute_again(graph, profile, schedule, step, scatter, needless) || !guesses_have_room(profile, schedule, step))
    return std::nullopt;
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
    std::map<PassId, std::vector<size_t>> groups;
    for (size_t k = 0; k < step.passes.size(); ++k)
      if (const auto map = map_of(graph, schedule, step, k)) groups[*map].push_back(k);
    for (const auto& [map, group] : groups)
      if (auto with = with_added(graph, profile, schedule, step, map, group, unused)) step = std::move(*with);
    remove_empty(step);
  }
  remove_resources(schedule, std::move(unused));
}

}  // namespace dr::backend
