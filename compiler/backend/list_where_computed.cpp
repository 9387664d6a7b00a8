// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/list_where_computed.h"

#include <algorithm>

#include "compiler/backend/limits.h"
#include "compiler/backend/uses.h"
#include "compiler/ir/pins.h"

namespace dr::backend {

using ir::ValueId;

namespace {

bool contains(const std::vector<ValueId>& values, ValueId v) { return std::ranges::find(values, v) != values.end(); }

// The pass that computes every value of the clauses, the last that one of them waits for; -1: there is none.
int lister(const ir::Graph& graph, const StepSchedule& step, size_t scatter) {
  const Pass& wants = step.passes[scatter];
  const auto computes = [&](const Pass& pass, ValueId v) {
    return std::ranges::find(pass.ops, graph.value(v).op) != pass.ops.end();
  };
  for (size_t k = scatter; k-- > 0;) {
    const Pass& pass = step.passes[k];
    if (pass.kind != Pass::Kind::Map || pass.hardware || pass.domain != wants.domain) continue;
    const bool all = std::ranges::all_of(wants.active, [&](const std::vector<ValueId>& clause) {
      return std::ranges::all_of(clause, [&](ValueId v) { return computes(pass, v); });
    });
    if (all) return static_cast<int>(k);
  }
  return -1;
}

}  // namespace

void list_where_computed(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule) {
  const std::map<ValueId, std::string> pins = ir::pin_names(graph);
  for (StepSchedule& step : schedule.steps) {
    std::set<ValueId> kept;
    for (const auto& [name, v] : step.outputs) kept.insert(v);
    for (const auto& [leaf, v] : step.updates) kept.insert(v);
    for (const auto& [v, name] : pins) kept.insert(v);
    std::set<int> taken;
    for (size_t k = 0; k < step.passes.size(); ++k) {
      Pass& scatter = step.passes[k];
      if (scatter.active.empty()) continue;
      const int by = lister(graph, step, k);
      if (by < 0 || taken.count(by) != 0) continue;
      Pass& pass = step.passes[static_cast<size_t>(by)];
      // Both run whenever the step does: else one could be left out without the other.
      if (!pass.steady || !scatter.steady) continue;
      constexpr uint32_t kLists = 2;  // its own heavy elements, and these
      uint32_t buffers = 0;
      for (const ValueId v : pass.reads)
        buffers += schedule.resources[step.stored.at(v).index].storage == Resource::Storage::Buffer ? 1 : 0;
      const uint32_t images = static_cast<uint32_t>(pass.reads.size()) - buffers;
      if (!fits(profile, {buffers + kLists, images, static_cast<uint32_t>(pass.writes.size()), false})) continue;
      taken.insert(by);
      scatter.listed_by = by;
      std::set<ValueId> elsewhere;
      for (const ir::OpId id : scatter.ops) {
        const Uses uses = uses_of(graph, graph.op(id));
        elsewhere.insert(uses.elsewhere.begin(), uses.elsewhere.end());
      }
      for (const ValueId v : pass.writes) {
        const bool others = std::ranges::any_of(
            step.passes, [&](const Pass& other) { return &other != &scatter && contains(other.reads, v); });
        if (kept.count(v) == 0 && elsewhere.count(v) == 0 && !others) pass.partial.push_back(v);
      }
    }
  }
}

}  // namespace dr::backend
