// SPDX-License-Identifier: Apache-2.0
// Numbers the values of a region op and of all regions inside it.
#include "compiler/reference/plan.h"

#include <algorithm>
#include <map>

#include "compiler/ir/yields.h"

namespace dr::reference {
namespace {

using ir::Graph;
using ir::Op;
using ir::RegionId;
using ir::ValueId;
using ir::Yield;
using Sinks = std::vector<uint32_t>;

class Planner {
 public:
  Planner(const Graph& graph, RegionId region, Planner* parent) : graph_(graph), region_(region), parent_(parent) {}

  uint32_t slot(ValueId id) {
    const auto [entry, is_new] = slots_.try_emplace(id, static_cast<uint32_t>(plan_.slots.size()));
    if (!is_new) return entry->second;
    const uint32_t number = entry->second;
    const ir::ValueInfo& info = graph_.value(id);
    Slot slot{.value = id, .type = info.type, .source = Slot::Source::Made, .parent_slot = 0};
    if (info.region != region_ || outermost_operand(id)) {
      slot.source = info.region == graph_.root() ? Slot::Source::Root : Slot::Source::Parent;
    }
    if (slot.source == Slot::Source::Parent) {
      DR_ASSERT(parent_ != nullptr);
      slot.parent_slot = parent_->slot(id);
    }
    plan_.slots.push_back(slot);
    return number;
  }

  // The plan of the region. `sinks` has, for each result of the region's op, where it scatters.
  Plan region(std::span<const Yield> yields, std::span<const Sinks> sinks) {
    const ir::Region& region = graph_.region(region_);
    for (ValueId param : region.params) plan_.params.push_back(slot(param));
    std::map<ValueId, Sinks> accumulations;
    size_t at = 0;
    for (size_t k = 0; k < yields.size(); ++k) {
      YieldPlan yield{.how = yields[k], .forwarded = false, .index = 0, .value = 0, .sinks = {}};
      if (yields[k] == Yield::Scatter) {
        yield.sinks = sinks[k];
        yield.forwarded = graph_.value(region.yields[at]).accumulation;
        if (yield.forwarded) {
          Sinks& into = accumulations[region.yields[at]];
          into.insert(into.end(), sinks[k].begin(), sinks[k].end());
          DR_ASSERT(graph_.value(region.yields[at]).region == region_);
        } else {
          yield.index = slot(region.yields[at++]);
        }
      }
      if (!yield.forwarded) yield.value = slot(region.yields[at]);
      ++at;
      plan_.yields.push_back(std::move(yield));
    }
    DR_ASSERT(at == region.yields.size());

    for (ir::OpId id : needed_ops(region)) add_op(graph_.op(id), accumulations);
    find_last_uses();
    return std::move(plan_);
  }

  // The plan with one op of the root.
  Plan root_op(const Op& op) {
    std::map<ValueId, Sinks> accumulations;
    uint32_t sinks = 0;
    for (size_t k = 0; k < op.results.size(); ++k) {
      if (op.attrs.yields[k] == Yield::Scatter) accumulations[op.results[k]] = {sinks++};
    }
    outermost_ = &op;
    add_op(op, accumulations);
    return std::move(plan_);
  }

 private:
  bool outermost_operand(ValueId id) const {
    return outermost_ != nullptr &&
           std::find(outermost_->results.begin(), outermost_->results.end(), id) == outermost_->results.end();
  }

  std::vector<ir::OpId> needed_ops(const ir::Region& region) const {
    std::vector<ir::OpId> ops;
    std::map<ValueId, bool> needed;
    for (ValueId yield : region.yields) needed[yield] = true;
    for (auto id = region.ops.rbegin(); id != region.ops.rend(); ++id) {
      const Op& op = graph_.op(*id);
      if (std::none_of(op.results.begin(), op.results.end(), [&](ValueId result) { return needed.count(result) != 0; }))
        continue;
      ops.push_back(*id);
      for (ValueId operand : op.operands) needed[operand] = true;
      for (RegionId inner : op.regions) {
        for (ValueId captured : ir::captures(graph_, inner)) needed[captured] = true;
      }
    }
    std::reverse(ops.begin(), ops.end());
    return ops;
  }

  void add_op(const Op& op, const std::map<ValueId, Sinks>& accumulations) {
    OpPlan plan;
    plan.op = &op;
    for (ValueId operand : op.operands) plan.operands.push_back(slot(operand));
    std::vector<Sinks> sinks(op.results.size());
    for (size_t k = 0; k < op.results.size(); ++k) {
      plan.results.push_back(slot(op.results[k]));
      // A sink that nobody yields on has no place to go to, and stays empty.
      if (const auto found = accumulations.find(op.results[k]); found != accumulations.end()) sinks[k] = found->second;
    }
    for (RegionId inner : op.regions) {
      if (op.kind == ir::OpKind::Fold) {
        plan.regions.push_back(sweep(op, inner, sinks));
      } else {
        plan.regions.push_back(Planner(graph_, inner, this).region(op.attrs.yields, sinks));
      }
    }
    plan_.ops.push_back(std::move(plan));
  }

  // Of a Fold: the stop and the states are elements; what the last sweep yields else is as the op says.
  Plan sweep(const Op& op, RegionId region, const std::vector<Sinks>& sinks) {
    std::vector<Yield> yields;
    std::vector<Sinks> places;
    if (region == op.regions.front() && ir::fold_stops(op)) yields.push_back(Yield::Element);
    places.resize(yields.size());
    if (region == op.regions.back()) {
      yields.insert(yields.end(), op.attrs.yields.begin(), op.attrs.yields.end());
      places.insert(places.end(), sinks.begin(), sinks.end());
    } else {
      yields.resize(graph_.region(region).yields.size(), Yield::Element);
      places.resize(yields.size());
    }
    return Planner(graph_, region, this).region(yields, places);
  }

  void find_last_uses() {
    constexpr size_t kNever = SIZE_MAX;
    std::vector<size_t> last(plan_.slots.size(), kNever);
    for (size_t k = 0; k < plan_.ops.size(); ++k) {
      const OpPlan& op = plan_.ops[k];
      // A result without a use is dead at once.
      for (uint32_t result : op.results) last[result] = k;
      for (uint32_t operand : op.operands) last[operand] = k;
      for (const Plan& region : op.regions) {
        for (const Slot& slot : region.slots) {
          if (slot.source == Slot::Source::Parent) last[slot.parent_slot] = k;
        }
      }
    }
    for (const YieldPlan& yield : plan_.yields) {
      if (yield.forwarded) continue;
      last[yield.value] = kNever;
      if (yield.how == Yield::Scatter) last[yield.index] = kNever;
    }
    for (uint32_t param : plan_.params) last[param] = kNever;
    for (uint32_t slot = 0; slot < last.size(); ++slot) {
      if (last[slot] != kNever && plan_.slots[slot].source == Slot::Source::Made)
        plan_.ops[last[slot]].dead.push_back(slot);
    }
  }

  const Graph& graph_;
  RegionId region_;
  Planner* parent_;
  const Op* outermost_ = nullptr;
  Plan plan_;
  std::map<ValueId, uint32_t> slots_;
};

}  // namespace

Plan plan_op(const Graph& graph, const Op& op) { return Planner(graph, graph.root(), nullptr).root_op(op); }

Plan plan_raster_region(const Graph& graph, RegionId region) {
  const Yield element = Yield::Element;
  const Sinks none;
  return Planner(graph, region, nullptr).region({&element, 1}, {&none, 1});
}

}  // namespace dr::reference
