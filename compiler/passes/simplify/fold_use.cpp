// SPDX-License-Identifier: Apache-2.0
#include "compiler/passes/simplify/fold_use.h"

#include <algorithm>
#include <set>

#include "compiler/ir/yields.h"

namespace dr::passes {

using namespace ir;

namespace {

// Adds the values of the region, and those that it captures, of which values in the set are made.
void add_sources(const Graph& graph, RegionId region, std::set<ValueId>& needed) {
  const std::vector<OpId>& ops = graph.region(region).ops;
  for (auto it = ops.rbegin(); it != ops.rend(); ++it) {
    const Op& op = graph.op(*it);
    if (std::ranges::none_of(op.results, [&](ValueId id) { return needed.contains(id); })) continue;
    needed.insert(op.operands.begin(), op.operands.end());
    for (const RegionId inner : op.regions) {
      const std::vector<ValueId> captured = captures(graph, inner);
      needed.insert(captured.begin(), captured.end());
    }
  }
}

// What a sweep must yield for the states and results that are needed so far.
std::vector<ValueId> needed_yields(const Graph& graph, const Op& op, size_t sweep, const FoldUse& use) {
  std::vector<ValueId> out;
  if (sweep == 0 && fold_stops(op)) out.push_back(fold_stop(graph, op));
  const std::span<const ValueId> next = fold_next(graph, op, sweep);
  for (size_t k = 0; k < next.size(); ++k)
    if (use.states[sweep][k]) out.push_back(next[k]);
  if (sweep + 1 < fold_sweeps(op)) return out;
  const std::vector<Yielded> parts = yielded(graph, op, op.regions.back());
  for (size_t k = next.size(); k < parts.size(); ++k) {
    if (!use.results[k]) continue;
    if (parts[k].index.valid()) out.push_back(parts[k].index);
    out.push_back(parts[k].value);
  }
  return out;
}

}  // namespace

bool FoldUse::drops(const Op& op) const {
  const auto lacks = [](const std::vector<bool>& all) { return std::ranges::find(all, false) != all.end(); };
  return std::ranges::any_of(states, lacks) || lacks(results) || groups.size() < fold_sweeps(op);
}

FoldUse fold_use(const Graph& graph, const Op& op, const std::function<bool(ValueId)>& is_needed) {
  const size_t sweeps = fold_sweeps(op), last = sweeps - 1;
  FoldUse use;
  for (size_t sweep = 0; sweep < sweeps; ++sweep)
    for (std::vector<bool>& states = use.states.emplace_back();
         const ValueId param : fold_params(graph, op, sweep, sweep))
      states.push_back(is_needed(param));
  for (const ValueId result : op.results) use.results.push_back(is_needed(result));
  for (bool grows = true; grows;) {
    grows = false;
    for (size_t k = 0; k < fold_states(op, last); ++k) use.states[last][k] = use.states[last][k] || use.results[k];
    for (size_t sweep = 0; sweep < sweeps; ++sweep) {
      const std::vector<ValueId> yields = needed_yields(graph, op, sweep, use);
      std::set<ValueId> needed(yields.begin(), yields.end());
      add_sources(graph, op.regions[sweep], needed);
      for (size_t of = 0; of <= sweep; ++of) {
        const std::span<const ValueId> params = fold_params(graph, op, sweep, of);
        for (size_t k = 0; k < params.size(); ++k) {
          if (use.states[of][k] || !needed.contains(params[k])) continue;
          use.states[of][k] = true;
          grows = true;
        }
      }
    }
  }
  for (size_t k = 0; k < fold_states(op, last); ++k) use.results[k] = use.states[last][k];
  for (size_t sweep = 0; sweep < sweeps; ++sweep) {
    use.yields.push_back(needed_yields(graph, op, sweep, use));
    const bool carries = std::ranges::find(use.states[sweep], true) != use.states[sweep].end();
    if (!carries && sweep != 0 && sweep != last) continue;
    if (use.groups.empty() || (use.groups.back().back() + sweep) % 2 != 0) {
      use.groups.emplace_back();
    }
    use.groups.back().push_back(sweep);
  }
  return use;
}

}  // namespace dr::passes
