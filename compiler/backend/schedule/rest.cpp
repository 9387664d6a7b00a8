// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/schedule/rest.h"

#include <algorithm>

#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/schedule/limits.h"
#include "compiler/ops/op.h"

namespace dr::backend {

using ir::Graph;
using ir::Op;
using ir::OpId;
using ir::OpKind;
using ir::ValueId;

namespace {

bool is_among(const std::vector<ValueId>& values, ValueId v) { return std::ranges::find(values, v) != values.end(); }

// The leaf that a step updates in place with a value.
std::optional<uint32_t> leaf_of(const StepSchedule& step, ValueId v) {
  for (const auto& [leaf, value] : step.updates)
    if (value == v && step.stored.at(v).index == leaf) return leaf;
  return std::nullopt;
}

// What an update takes from the pass of its gradient.
std::vector<ValueId> taken(const Pass& gradient, const Pass& update) {
  std::vector<ValueId> out;
  for (const ValueId v : gradient.writes)
    if (is_among(update.reads, v)) out.push_back(v);
  return out;
}

// Exact sums that the update alone reads, in place, and leaves empty.
bool is_exact_gradient(const Graph& graph, const Schedule& schedule, const StepSchedule& step, const Pass& update,
                       const Pass& pass) {
  const auto& scatter = pass.get<ScatterPass>();
  const std::vector<ValueId> sums = taken(pass, update);
  return pass.steady && !sums.empty() && std::ranges::all_of(sums, [&](ValueId v) {
           const auto sum = std::ranges::find(scatter.sums, v, &ScatterSum::value);
           return sum != scatter.sums.end() && schedule.resources[step.stored.at(v).index].is_sums() &&
                  graph.value(v).extent == update.domain && may_empty(graph, step, pass, *sum);
         });
}

// Sums by float atomics that it leaves empty likewise.
bool is_atomic_gradient(const Graph& graph, const Schedule& schedule, const StepSchedule& step, const Pass& update,
                        const Pass& pass) {
  const std::vector<ValueId> sums = taken(pass, update);
  return !sums.empty() && std::ranges::all_of(sums, [&](ValueId v) {
    const auto& all = pass.get<ScatterPass>().sums;
    const auto sum = std::ranges::find(all, v, &ScatterSum::value);
    return sum != all.end() && graph.value(v).extent == update.domain &&
           may_empty_floats(graph, schedule.resources, step, pass, *sum);
  });
}

bool is_gradient(const Graph& graph, const Schedule& schedule, const StepSchedule& step, const Pass& update,
                 const AtRest& rest) {
  const Pass& pass = step.pass(rest.gradient);
  const auto* scatter = pass.as<ScatterPass>();
  if (scatter != nullptr && scatter->lowering() == ScatterLowering::Atomic)
    return rest.is_marked() && is_atomic_gradient(graph, schedule, step, update, pass);
  if (scatter != nullptr && scatter->exact() != nullptr) return is_exact_gradient(graph, schedule, step, update, pass);
  const auto* rows = scatter == nullptr ? nullptr : std::get_if<RowsScatter>(&scatter->how);
  if (rows == nullptr || rows->sorted() == nullptr || !pass.steady) return false;
  if (pass.writes.size() != scatter->sums.size()) return false;
  const std::set<ValueId> kept = read_afterwards(graph, step);
  return std::ranges::all_of(pass.writes, [&](ValueId v) {
    if (kept.count(v) != 0 || graph.value(v).extent != update.domain) return false;
    return std::ranges::all_of(step.passes, [&](const Pass& p) { return &p == &update || !is_among(p.reads, v); });
  });
}

bool is_plain_update(const Graph& graph, const Schedule& schedule, const StepSchedule& step, PassId id,
                     const AtRest& rest) {
  const Pass& pass = step.pass(id);
  const auto* map = pass.as<MapPass>();
  if (map == nullptr || !pass.steady || map->block || !map->partial.empty() || map->code.cut) return false;
  if (!listed_for(step, id).empty() || set_up_for(step, id) != nullptr) return false;
  // Loops gather, or nothing is known of what they give.
  const auto is_unknown = [&](OpId op) {
    return !graph.op(op).regions.empty() && std::ranges::find(rest.gathers, op) == rest.gathers.end();
  };
  if (std::ranges::any_of(pass.ops, is_unknown)) return false;
  return std::ranges::all_of(pass.writes, [&](ValueId v) {
    const auto leaf = leaf_of(step, v);
    const ir::Type& type = graph.value(v).type;
    // What the leaf holds is there to compare with.
    const auto is_old = [&](ValueId read) { return step.stored.at(read) == step.stored.at(v); };
    return leaf && type.is_float() && type.cols == 1 && schedule.resources[*leaf].extent == pass.domain &&
           std::ranges::any_of(pass.reads, is_old);
  });
}

}  // namespace

RestFacts facts_at_rest(const Graph& graph, const StepSchedule& step, const Pass& update, const AtRest& rest) {
  const std::vector<bool> steady = steady_ops(graph, graph.steps[*graph.step_index(step.name)]);
  std::set<uint32_t> changed, own, memory;
  for (const auto& [leaf, v] : step.updates) changed.insert(leaf);
  for (const ValueId v : update.writes) own.insert(step.stored.at(v).index);
  for (const ValueId v : rest.memory) memory.insert(step.stored.at(v).index);
  RestFacts known;
  for (const ValueId v : taken(step.pass(rest.gradient), update)) known.zero.insert(v);
  for (const ValueId v : gathered_at_rest(graph, rest)) known.zero.insert(v);
  for (const OpId id : graph.region(graph.root()).ops) {
    const Op& op = graph.op(id);
    if (op.kind == OpKind::Leaf) {
      const uint32_t leaf = *graph.leaf_index(op.attrs.text);
      if (memory.count(leaf) != 0)
        known.zero.insert(op.results[0]);
      else if (changed.count(leaf) == 0 || own.count(leaf) != 0)
        known.fixed.insert(op.results[0]);
    } else if (!steady[id.index]) {
      known.fixed.insert(op.results.begin(), op.results.end());
    }
  }
  return facts_at_rest(graph, std::move(known));
}

std::vector<OpId> ops_at_rest(const Graph& graph, const Pass& update, const RestFacts& facts) {
  std::set<ValueId> needed;
  for (const ValueId v : update.writes) needed.insert(v);
  std::vector<OpId> out;
  for (size_t k = update.ops.size(); k-- > 0;) {
    const Op& op = graph.op(update.ops[k]);
    const ValueId result = op.results[0];
    if (needed.count(result) == 0 || facts.zero.count(result) != 0) continue;
    out.push_back(update.ops[k]);
    if (const auto chosen = facts.chosen.find(result); chosen != facts.chosen.end())
      needed.insert(chosen->second);
    else
      needed.insert(op.operands.begin(), op.operands.end());
  }
  std::ranges::reverse(out);
  return out;
}

bool may_rest(const Graph& graph, const Schedule& schedule, const StepSchedule& step, PassId update,
              const AtRest& rest) {
  const Pass& pass = step.pass(update);
  if (!rest.gathers.empty() && !rest.in_blocks) return false;
  if (!(rest.gradient < update) || !is_plain_update(graph, schedule, step, update, rest) ||
      !is_gradient(graph, schedule, step, pass, rest))
    return false;
  // The reader of the first element leaves the exponent that the next run guesses, and may rest where it has no mark.
  if (step.pass(rest.gradient).get<ScatterPass>().guesses() && !rest.is_marked()) return false;
  const std::vector<ValueId> sums = taken(step.pass(rest.gradient), pass);
  // Places to look at are known before sums are taken.
  for (const OpId id : ops_of(graph, pass.ops, gathered_at_rest(graph, rest)))
    if (std::ranges::any_of(uses_of(graph, graph.op(id)).at_element, [&](ValueId v) { return is_among(sums, v); }))
      return false;
  for (const OpId id : pass.ops) {
    const Uses uses = uses_of(graph, graph.op(id));
    if (std::ranges::any_of(sums, [&](ValueId v) { return is_among(uses.elsewhere, v); })) return false;
  }
  const RestFacts facts = facts_at_rest(graph, step, pass, rest);
  if (!std::ranges::all_of(pass.writes, [&](ValueId v) { return facts.fixed.count(v) != 0; })) return false;
  // What is read to tell is there before the sums, and before the map that adds to them.
  const JoinedRun* joined = step.pass(rest.gradient).get<ScatterPass>().joined_run();
  std::set<ValueId> later;
  for (size_t k = joined != nullptr ? joined->lister.index : rest.gradient.index; k < step.passes.size(); ++k)
    later.insert(step.passes[k].writes.begin(), step.passes[k].writes.end());
  for (const OpId id : ops_at_rest(graph, pass, facts))
    for (const ValueId v : graph.op(id).operands)
      if (is_among(pass.reads, v) && later.count(v) != 0 && facts.zero.count(v) == 0) return false;
  return true;
}

std::vector<OpId> stirring_gathers(const Graph& graph, const StepSchedule& step, const Pass& update) {
  std::vector<OpId> out;
  for (const OpId id : update.ops) {
    const Op& op = graph.op(id);
    const auto is_float = [&](ValueId v) { return graph.value(v).type.is_float(); };
    if ((op.kind != OpKind::Gather && op.regions.empty()) || !std::ranges::all_of(op.results, is_float)) continue;
    const std::vector<ValueId> read = uses_of(graph, op).elsewhere;
    const auto made = [&](const Pass& pass) {
      return pass.steady && std::ranges::any_of(read, [&](ValueId v) { return is_among(pass.writes, v); });
    };
    if (std::ranges::any_of(step.passes, made)) out.push_back(id);
  }
  return out;
}

std::vector<ValueId> gathered_at_rest(const Graph& graph, const AtRest& rest) {
  std::vector<ValueId> out;
  for (const OpId id : rest.gathers) out.insert(out.end(), graph.op(id).results.begin(), graph.op(id).results.end());
  return out;
}

const Pass* update_of(const StepSchedule& step, PassId gradient, std::optional<ValueId> sum) {
  const auto found = std::ranges::find_if(step.passes, [&](const Pass& pass) {
    const auto* map = pass.as<MapPass>();
    return map != nullptr && map->rest && map->rest->gradient == gradient && (!sum || is_among(pass.reads, *sum));
  });
  return found == step.passes.end() ? nullptr : &*found;
}

}  // namespace dr::backend
