// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/list_where_computed.h"

#include <algorithm>

#include "compiler/backend/analysis/bins.h"
#include "compiler/backend/analysis/scatter_leaves.h"
#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/analysis/zero_without.h"
#include "compiler/backend/lowering/heavy_branches.h"
#include "compiler/backend/lowering/scatter_active.h"
#include "compiler/backend/lowering/scatter_costs.h"
#include "compiler/backend/schedule/limits.h"
#include "compiler/backend/schedule/trips.h"

namespace dr::backend {

using ir::ValueId;

namespace {

// Whether elements add only where the lister takes a branch that has a dispatch of its own.
bool adds_in_branch(const ir::Graph& graph, const target::Profile& profile, const Pass& lister, const Pass& scatter) {
  const auto heavy = heavy_branches(graph, lister, trips_of(graph, lister.ops), profile);
  return !heavy.empty() && adds_nothing_without(graph, scatter.get<ScatterPass>(), heavy);
}

// Whether the lister can do at an active element what the scatter's first run does: all that it needs is there by then,
// nothing that the lister writes is read at other places, and one shader may bind it all. Where lanes run both branches
// of every `if`, few elements would make all pay.
bool may_join(const ir::Graph& graph, const target::Profile& profile, bool branches, const Schedule& schedule,
              const StepSchedule& step, const Pass& scatter) {
  const PassId lister = *scatter.lister();
  if (profile.lanes_in_turn && !(branches && adds_in_branch(graph, profile, step.pass(lister), scatter))) return false;
  // Behind the lister's loops its shader has stored where it stopped, so loops that follow must not be cut with them.
  Trips trips = trips_of(graph, scatter.ops);
  for (const Pass* other : listed_for(step, lister))
    if (other != &scatter && other->get<ScatterPass>().joined_run() != nullptr) trips += trips_of(graph, other->ops);
  if (trips.loops > 0 && needs_cut(trips + trips_of(graph, step.pass(lister).ops), profile)) return false;
  const std::vector<ScatterSum>& sums = scatter.get<ScatterPass>().sums;
  // Few lanes of a subgroup add where a map does, and those that add to few elements wait for each other.
  const auto& how = scatter.get<ScatterPass>();
  if (how.binned() != nullptr && how.joins_parts()) return false;
  // Sums in bins add nothing in a first run that others need.
  const auto is_binned = [&](const ScatterSum& s) { return adds_in_bins(graph, s.value, s.terms); };
  if (how.exact() != nullptr && std::ranges::any_of(sums, is_binned)) return false;
  for (const ValueId v : scatter.writes) {
    const bool sum = std::ranges::any_of(sums, [&](const ScatterSum& s) { return s.value == v; });
    if (!sum || !graph.value(v).type.is_float()) return false;
  }
  return is_computed_by_then(graph, step, lister, scatter) &&
         fits(profile, joined_bindings(schedule.resources, step, scatter));
}

// Whether what elements add may be kept: each term adds once at most, and shaders may bind one more buffer a sum.
bool may_keep_terms(const ir::Graph& graph, const target::Profile& profile, const Schedule& schedule,
                    const StepSchedule& step, const Pass& scatter) {
  constexpr int kMostWords = 64;  // of an element
  int words = 0;
  const std::vector<ScatterSum>& sums = scatter.get<ScatterPass>().sums;
  for (const ScatterSum& sum : sums)
    for (const ValueId term : sum.terms) {
      if (contributions(graph, term) != 1) return false;
      words += graph.value(term).type.components() + 1;
    }
  // There may be no room for what some elements add.
  if (needs_cut(trips_of(graph, scatter.ops), profile, kElementsInTurn)) return false;
  Bindings bindings = joined_bindings(schedule.resources, step, scatter);
  bindings.writes += static_cast<uint32_t>(sums.size());
  return words <= kMostWords && fits(profile, bindings);
}

bool reads(const Pass& pass, ValueId v) { return contains(pass.reads, v); }

// Conditions that all listed elements fulfil are read by none of them, and need no memory.
void forget_conditions(const ir::Graph& graph, StepSchedule& step, Pass& lister, Pass& scatter,
                       std::set<uint32_t>& unused) {
  for (const ValueId v : true_where_listed(graph, scatter)) {
    // Something of the lister's must be left that the scatter waits for.
    const auto waits = std::ranges::count_if(scatter.reads, [&](ValueId r) { return contains(lister.writes, r); });
    if (!contains(lister.get<MapPass>().partial, v) || waits < 2) continue;
    if (std::ranges::count_if(step.passes, [&](const Pass& pass) { return reads(pass, v); }) > 1) continue;
    std::erase(lister.get<MapPass>().partial, v);
    std::erase(lister.writes, v);
    std::erase(scatter.reads, v);
    unused.insert(step.stored.at(v).index);
    step.stored.erase(v);
  }
}

// What a map may list before an adjoint is there: elements that take one of its heavy branches, which are few.
struct Listing {
  PassId by;
  Clauses clauses;
  std::vector<ValueId> zeros;  // of those left out of the clauses: where one is zero, the element adds nothing
};

bool computes(const ir::Graph& graph, const Pass& pass, ValueId v) {
  return std::ranges::find(pass.ops, graph.value(v).op) != pass.ops.end();
}

// The values of clauses that a map computes, if each clause keeps one, and one at least is false without the branches.
std::optional<Clauses> computed_clauses(const ir::Graph& graph, const Pass& map, const Clauses& clauses,
                                        std::span<const ir::OpId> heavy) {
  Clauses out;
  for (std::vector<ValueId> clause : clauses) {
    std::erase_if(clause, [&](ValueId v) { return !computes(graph, map, v); });
    if (std::ranges::none_of(clause, [&](ValueId v) { return is_zero_without(graph, v, heavy); })) return {};
    if (std::ranges::find(out, clause) == out.end()) out.push_back(std::move(clause));
  }
  return out;
}

std::optional<Listing> list_early(const ir::Graph& graph, const target::Profile& profile, const StepSchedule& step,
                                  size_t scatter, const Clauses& clauses) {
  for (size_t k = scatter; k-- > 0;) {
    const Pass& map = step.passes[k];
    if (!map.is<MapPass>() || map.domain != step.passes[scatter].domain) continue;
    const auto heavy = heavy_branches(graph, map, trips_of(graph, map.ops), profile);
    if (heavy.empty()) continue;
    auto computed = computed_clauses(graph, map, clauses, heavy);
    if (!computed) continue;
    std::vector<ValueId> zeros = clauses[0];
    std::erase_if(zeros, [&](ValueId v) {
      return !contains(step.passes[scatter].reads, v) || computes(graph, map, v) ||
             std::ranges::any_of(clauses, [&](const std::vector<ValueId>& c) { return !contains(c, v); });
    });
    return Listing{pass_id(k), std::move(*computed), std::move(zeros)};
  }
  return std::nullopt;
}

void choose_listers(const ir::Graph& graph, const target::Profile& profile, const Schedule& schedule,
                    StepSchedule& step) {
  for (size_t k = 0; k < step.passes.size(); ++k) {
    const Pass& scatter = step.passes[k];
    auto* sums = step.passes[k].as<ScatterPass>();
    ActiveList* active = sums == nullptr ? nullptr : sums->active_list();
    if (active == nullptr) continue;
    std::optional<Listing> early;
    auto by = find_lister(graph, step, k, active->clauses);
    if (!by) {
      early = list_early(graph, profile, step, k, active->clauses);
      if (!early) continue;
      by = early->by;
    }
    const Pass& pass = step.pass(*by);
    // Both run whenever the step does: else one could be left out without the other.
    if (!pass.steady || !scatter.steady) continue;
    Bindings own = bindings_of(schedule.resources, resources_of(step, pass.reads), pass.writes.size());
    const std::vector<const Pass*> others = listed_for(step, *by);
    own.more += lists_bound(others.size() + 1) + static_cast<uint32_t>(guesses_bound(schedule.resources, step, pass));
    for (const Pass* other : others)
      if (const auto& sums_of = other->get<ScatterPass>(); sums_of.joined_run() != nullptr)
        own.more += static_cast<uint32_t>(sums_of.sums.size());
    if (!fits(profile, own)) continue;
    active->listed_by = *by;
    if (!early) continue;
    active->clauses = std::move(early->clauses);
    // A GPU's dispatch takes longer than what it would save.
    if (ExactScatter* exact = sums->exact(); exact != nullptr && profile.lanes_in_turn)
      std::get<OwnFirstRun>(exact->first_run).nonzero = std::move(early->zeros);
  }
}

// What listed elements alone need is stored at these alone.
void store_partly(const ir::Graph& graph, StepSchedule& step) {
  const std::set<ValueId> kept = read_afterwards(graph, step);
  for (size_t k = 0; k < step.passes.size(); ++k) {
    auto* map = step.passes[k].as<MapPass>();
    if (map == nullptr || listed_for(step, pass_id(k)).empty()) continue;
    for (const ValueId v : step.passes[k].writes) {
      const bool others = std::ranges::any_of(step.passes, [&](const Pass& pass) {
        return reads(pass, v) && (pass.lister() != pass_id(k) || read_elsewhere(graph, pass).count(v) != 0);
      });
      if (kept.count(v) == 0 && !others) map->partial.push_back(v);
    }
  }
}

}  // namespace

void list_where_computed(const ir::Graph& graph, const target::Profile& profile, bool branches, Schedule& schedule) {
  std::set<uint32_t> unused;
  for (StepSchedule& step : schedule.steps) {
    choose_listers(graph, profile, schedule, step);
    store_partly(graph, step);
    for (Pass& scatter : step.passes) {
      const auto lister = scatter.lister();
      if (!lister || scatter.get<ScatterPass>().joined_run() != nullptr) continue;
      auto& sums = scatter.get<ScatterPass>();
      forget_conditions(graph, step, step.pass(*lister), scatter, unused);
      if (!may_join(graph, profile, branches, schedule, step, scatter)) continue;
      sums.join_lister();
      if (ExactScatter* exact = sums.exact()) {
        exact->joins_pairs = pairs_may_join(graph, profile, scatter);
        std::get<JoinedFirstRun>(exact->first_run).keeps_terms =
            !exact->joins_pairs && may_keep_terms(graph, profile, schedule, step, scatter);
      }
    }
  }
  remove_resources(schedule, std::move(unused));
}

}  // namespace dr::backend
