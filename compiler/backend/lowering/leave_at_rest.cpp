// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/leave_at_rest.h"

#include <algorithm>

#include "compiler/backend/schedule/limits.h"
#include "compiler/backend/schedule/rest.h"
#include "compiler/backend/schedule/trips.h"

namespace dr::backend {

using ir::OpKind;
using ir::ValueId;

namespace {

// What an optimizer remembers of an element: states that the update changes.
std::vector<ValueId> memory_of(const ir::Graph& graph, const StepSchedule& step, const Pass& update) {
  std::vector<ValueId> out;
  for (const ValueId v : update.reads) {
    const ir::Op& op = graph.op(graph.value(v).op);
    if (op.kind != OpKind::Leaf) continue;
    const uint32_t leaf = *graph.leaf_index(op.attrs.text);
    const auto is_it = [&](ValueId written) { return step.stored.at(written).index == leaf; };
    if (graph.leaves[leaf].kind == ir::Leaf::Kind::State && std::ranges::any_of(update.writes, is_it)) out.push_back(v);
  }
  return out;
}

// Shaders that list, sum and step bind the list, too, and the one that lists where the rows start. One that sums for
// several updates binds a list and marks for each: `others` rest already.
bool fits_with_lists(const Schedule& schedule, const StepSchedule& step, const Pass& pass,
                     const target::Profile& profile, size_t others = 0) {
  Bindings all = bindings_of(schedule.resources, resources_of(step, pass.reads), pass.writes.size());
  all.more += 3 + 2 * static_cast<uint32_t>(others);
  return fits(profile, all);
}

size_t resting_on(const StepSchedule& step, PassId gradient) {
  return static_cast<size_t>(std::ranges::count_if(step.passes, [&](const Pass& pass) {
    const auto* map = pass.as<MapPass>();
    return map != nullptr && map->rest && map->rest->gradient == gradient;
  }));
}

// Few elements, as vertices are, which are as many as an image has in one row.
bool is_list(const Pass& update) { return update.domain.h.is_one(); }

// Of an invocation that takes elements in turn, for one of them.
Trips trips_of_elements(const ir::Graph& graph, const Pass& update) {
  Trips out = trips_of(graph, update.ops);
  out.most = out.most + ir::Dim(2);
  return out;
}

// How elements of an update rest without a gradient, if they may.
std::optional<AtRest> at_rest(const ir::Graph& graph, const target::Profile& profile, const Schedule& schedule,
                              const StepSchedule& step, PassId update, PassId gradient) {
  const ScatterLowering how = step.pass(gradient).get<ScatterPass>().lowering();
  const bool exact = how == ScatterLowering::Exact, rows = how == ScatterLowering::Rows;
  AtRest rest{gradient, memory_of(graph, step, step.pass(update)), false, false, false, {}};
  // Lanes of a GPU that have nothing to do end together, which takes less than going by a list.
  rest.in_blocks = !rows && profile.is_gpu();
  // Waking an element takes a list five accesses, which lanes in turn do for all elements alike. A bit takes three, and
  // few words hold the bits of a list of elements.
  rest.in_bits = !rows && profile.lanes_in_turn && is_list(step.pass(update));
  if (rest.in_bits && needs_cut(trips_of_elements(graph, step.pass(update)), profile, kListedRun)) return std::nullopt;
  rest.lists_in_runs = profile.lanes_in_turn && !rest.in_blocks && !rest.in_bits;
  if ((rest.in_blocks || profile.lanes_in_turn || !exact) && may_rest(graph, schedule, step, update, rest)) return rest;
  if (rest.in_bits) return std::nullopt;
  // What is gathered is looked at for all elements: they are marked.
  rest.gathers = stirring_gathers(graph, step, step.pass(update));
  // An update whose loops are cut goes on with elements that it has taken sums of.
  if (needs_cut(trips_of(graph, step.pass(update).ops), profile)) return std::nullopt;
  rest.lists_in_runs = false;
  rest.in_blocks = rows || profile.is_gpu() || profile.lanes_in_turn;
  if (!rest.gathers.empty() && rest.in_blocks && may_rest(graph, schedule, step, update, rest)) return rest;
  return std::nullopt;
}

}  // namespace

void leave_at_rest(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule) {
  for (StepSchedule& step : schedule.steps)
    for (size_t u = 0; u < step.passes.size(); ++u) {
      if (!step.passes[u].is<MapPass>()) continue;
      for (size_t g = 0; g < u; ++g) {
        Pass& update = step.passes[u];
        const Pass& gradient = step.passes[g];
        const bool reads = gradient.is<ScatterPass>() && std::ranges::any_of(gradient.writes, [&](ValueId v) {
                             return std::ranges::find(update.reads, v) != update.reads.end();
                           });
        if (!reads) continue;
        const ScatterLowering how = gradient.get<ScatterPass>().lowering();
        // Elsewhere than where lanes are in turn, looking for those of a list that rest takes longer than stepping
        // them.
        if (how != ScatterLowering::Rows && is_list(update) && !profile.lanes_in_turn) continue;
        std::optional<AtRest> rest = at_rest(graph, profile, schedule, step, pass_id(u), pass_id(g));
        if (!rest) continue;
        if (!fits_with_lists(schedule, step, update, profile) ||
            !fits_with_lists(schedule, step, gradient, profile, resting_on(step, pass_id(g))))
          continue;
        update.get<MapPass>().rest = std::move(*rest);
        if (how == ScatterLowering::Rows) break;
        for (const ScatterSum& sum : gradient.get<ScatterPass>().sums)
          if (std::ranges::find(update.reads, sum.value) != update.reads.end())
            schedule.resources[step.stored.at(sum.value).index].storage =
                how == ScatterLowering::Exact ? Resource::Storage::EmptiedSums : Resource::Storage::Emptied;
        break;
      }
    }
}

}  // namespace dr::backend
