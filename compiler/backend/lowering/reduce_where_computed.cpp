// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/reduce_where_computed.h"

#include <algorithm>
#include <optional>
#include <set>

#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/schedule/limits.h"

namespace dr::backend {

using ir::OpId;
using ir::ValueId;

namespace {

// What ops of a pass load.
std::vector<ValueId> reads_of(const ir::Graph& graph, const StepSchedule& step, std::span<const OpId> ops) {
  std::set<ValueId> made, read;
  for (const OpId id : ops) {
    const Uses uses = uses_of(graph, graph.op(id));
    for (const std::vector<ValueId>* some : {&uses.at_element, &uses.elsewhere})
      for (const ValueId v : *some)
        if (made.count(v) == 0 && step.stored.count(v) != 0) read.insert(v);
    made.insert(graph.op(id).results.begin(), graph.op(id).results.end());
  }
  return {read.begin(), read.end()};
}

class ReduceWhereComputed {
 public:
  ReduceWhereComputed(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule, StepSchedule& step)
      : graph_(graph), profile_(profile), schedule_(schedule), step_(step), kept_(read_afterwards(graph, step)) {}

  void process(std::set<uint32_t>& unused) {
    for (size_t k = 0; k < step_.passes.size(); ++k) {
      const auto map = map_of(k);
      if (!map) continue;
      const ValueId folded = graph_.op(step_.passes[k].ops[0]).operands[0];
      unused.insert(step_.stored.at(folded).index);
      step_.stored.erase(folded);
      take_over(step_.passes[*map], folded, step_.passes[k]);
      if (!step_.passes[*map].writes.empty()) continue;
      step_.passes.erase(step_.passes.begin() + static_cast<ptrdiff_t>(*map));
      if (*map < k) --k;
    }
  }

 private:
  // The place of the map that computes what the reduction at `place` folds, for it alone.
  std::optional<size_t> map_of(size_t place) const {
    const Pass& reduction = step_.passes[place];
    if (!reduction.is<ReducePass>() || reduction.ops.size() != 1 || !reduction.domain.h.is_one()) return std::nullopt;
    const ValueId folded = graph_.op(reduction.ops[0]).operands[0];
    const auto reads = [&](const Pass& pass) { return std::ranges::count(pass.reads, folded) > 0; };
    if (kept_.contains(folded) || std::ranges::count_if(step_.passes, reads) != 1) return std::nullopt;
    for (size_t k = 0; k < step_.passes.size(); ++k) {
      const Pass& map = step_.passes[k];
      if (std::ranges::count(map.writes, folded) > 0)
        return map.is<MapPass>() && map.domain == reduction.domain && map.steady == reduction.steady &&
                       may_take_over(k, folded, place)
                   ? std::optional(k)
                   : std::nullopt;
    }
    return std::nullopt;
  }

  // Whether what computes a value has no loops, computes nothing else, and leaves the reduction's shader within limits.
  // Sums stay as they were added up for one reader, and leaves are updated in place where nothing reads them later:
  // these are left to the map.
  bool may_take_over(size_t at, ValueId folded, size_t reduction) const {
    const Pass& map = step_.passes[at];
    const std::vector<OpId> taken = ops_of(graph_, map.ops, std::vector{folded}), left = left_of(map, folded);
    const auto may_take = [&](OpId id) {
      const ir::Op& op = graph_.op(id);
      return op.regions.empty() && (is_inline(op) || std::ranges::count(left, id) == 0);
    };
    const auto is_sum = [&](ValueId v) { return pass_kind(graph_.op(graph_.value(v).op)) == PassKind::Scatter; };
    const auto is_updated = [&](ValueId v) {
      const auto update =
          std::ranges::find(step_.updates, step_.stored.at(v).index, [](const auto& u) { return u.first; });
      return update != step_.updates.end() &&
             std::any_of(step_.passes.begin() + static_cast<ptrdiff_t>(at),
                         step_.passes.begin() + static_cast<ptrdiff_t>(reduction),
                         [&](const Pass& pass) { return std::ranges::count(pass.writes, update->second) > 0; });
    };
    const std::vector<ValueId> reads = reads_of(graph_, step_, taken);
    return std::ranges::all_of(taken, may_take) && std::ranges::none_of(reads, is_sum) &&
           std::ranges::none_of(reads, is_updated) &&
           fits(profile_, bindings_of(schedule_.resources, resources_of(step_, reads), 1));
  }

  std::vector<OpId> left_of(const Pass& map, ValueId folded) const {
    std::vector<ValueId> others = map.writes;
    std::erase(others, folded);
    return ops_of(graph_, map.ops, others);
  }

  void take_over(Pass& map, ValueId folded, Pass& reduction) {
    const std::vector<OpId> taken = ops_of(graph_, map.ops, std::vector{folded});
    reduction.ops.insert(reduction.ops.begin(), taken.begin(), taken.end());
    reduction.reads = reads_of(graph_, step_, reduction.ops);
    map.ops = left_of(map, folded);
    map.reads = reads_of(graph_, step_, map.ops);
    std::erase(map.writes, folded);
  }

  const ir::Graph& graph_;
  const target::Profile& profile_;
  const Schedule& schedule_;
  StepSchedule& step_;
  const std::set<ValueId> kept_;
};

}  // namespace

void reduce_where_computed(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule) {
  std::set<uint32_t> unused;
  for (StepSchedule& step : schedule.steps) ReduceWhereComputed(graph, profile, schedule, step).process(unused);
  remove_resources(schedule, std::move(unused));
}

}  // namespace dr::backend
