// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/heavy_branches.h"

#include <algorithm>
#include <limits>
#include <map>
#include <set>

#include "compiler/backend/analysis/shared_loops.h"
#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/analysis/zero_without.h"
#include "compiler/backend/cost/cost.h"
#include "compiler/backend/lowering/scatter_costs.h"
#include "compiler/ir/yields.h"

namespace dr::backend {
namespace {

// What must be left out for each element to pay for a list and a dispatch more, in op_cost() units, and how many times
// what is done instead. How many elements take a branch is not known: branches that cost 126 take, with a list, half
// the time where one element in fifty takes them, nine tenths where a third do, and half as long again where all do.
constexpr int kWorthListing = 120, kTimesLighter = 4;
// Lighter branches run for all: a common one would put most elements on the list.
constexpr int kHeavy = 20;
constexpr int kLoopTrips = 8;

int region_cost(const ir::Graph& graph, ir::RegionId region);

// Of an op with all that its regions do.
int whole_cost(const ir::Graph& graph, const ir::Op& op) {
  int cost = op.regions.empty() ? op_cost(op.kind) : 0;
  for (const ir::RegionId inner : op.regions)
    cost += region_cost(graph, inner) * (ir::is_loop(op.kind) ? kLoopTrips : 1);
  return cost;
}

int region_cost(const ir::Graph& graph, ir::RegionId region) {
  int cost = 0;
  for (const ir::OpId id : graph.region(region).ops) cost += whole_cost(graph, graph.op(id));
  return cost;
}

// What ops cost of which sinks are made, if a condition is false. None: whatever conditions are.
class Needed {
 public:
  Needed(const ir::Graph& graph, const Pass& pass) : graph_(graph) {
    for (const ir::OpId id : pass.ops) places_.emplace(id, places_.size());
    ops_.reserve(pass.ops.size());
    for (const ir::OpId id : pass.ops) {
      const ir::Op& op = graph.op(id);
      OpUse& use = ops_.emplace_back(OpUse{whole_cost(graph, op), {}, {}, {}});
      const Uses uses = uses_of(graph, op);
      for (const auto* list : {&uses.at_element, &uses.elsewhere})
        for (const ir::ValueId operand : *list) include(operand, use.operands);
      if (op.kind != ir::OpKind::Select) continue;
      use.condition = op.operands[0];
      for (const size_t k : {size_t{0}, size_t{2}}) include(op.operands[k], use.if_false);
    }
  }

  // Or more than `most`, where it is more than that.
  int cost(std::span<const ir::ValueId> sinks, std::optional<ir::OpId> select, int most) {
    const ir::ValueId no = select ? graph_.op(*select).operands[0] : ir::ValueId{};
    std::vector<size_t> open;
    for (const ir::ValueId v : sinks)
      if (!select || !is_zero_without(graph_, v, {&*select, 1})) include(v, open);
    seen_.assign(ops_.size(), false);
    int cost = 0;
    while (!open.empty() && cost <= most) {
      const size_t place = open.back();
      open.pop_back();
      if (seen_[place]) continue;
      seen_[place] = true;
      const OpUse& use = ops_[place];
      const bool is_false = no.valid() && use.condition == no;
      if (!is_false) cost += use.cost;
      const std::vector<size_t>& operands = is_false ? use.if_false : use.operands;
      open.insert(open.end(), operands.begin(), operands.end());
    }
    return cost;
  }

 private:
  struct OpUse {
    int cost;
    ir::ValueId condition;  // of a select
    // Places among the pass's ops.
    std::vector<size_t> operands, if_false;
  };

  void include(ir::ValueId v, std::vector<size_t>& places) const {
    const auto found = places_.find(graph_.value(v).op);
    if (found != places_.end()) places.push_back(found->second);
  }

  const ir::Graph& graph_;
  std::map<ir::OpId, size_t> places_;
  std::vector<OpUse> ops_;
  std::vector<bool> seen_;
};

// Whether there surely are more elements than a GPU runs at once. A heavy branch needs registers, so that fewer run at
// once, whether they take it or not; a dispatch more costs as much as some hundred thousand elements. Loops within
// loops need them all. Where lanes share loops, it pays unless there surely are fewer.
bool is_large(const ir::Extent& domain, int saved, bool shares) {
  constexpr int kManyRegisters = 1 << 16;
  const int64_t large = shares ? 1 << 17 : saved < kManyRegisters ? 1 << 20 : 1 << 18;
  const auto elements = (domain.w * domain.h * domain.l).evaluate({});
  return elements ? *elements >= large : shares;
}

}  // namespace

std::vector<ir::OpId> heavy_branches(const ir::Graph& graph, const Pass& pass, const Trips& trips,
                                     const target::Profile& profile) {
  std::vector<ir::OpId> heavy;
  if (may_pass_limit(trips, profile)) return heavy;
  int saved = 0;
  for (const ir::OpId id : pass.ops) {
    const ir::Op& op = graph.op(id);
    if (op.kind != ir::OpKind::If) continue;
    const int then = region_cost(graph, op.regions[0]), otherwise = region_cost(graph, op.regions[1]);
    if (then < kHeavy || then < kTimesLighter * (otherwise + 1)) continue;
    heavy.push_back(id);
    saved += then;
  }
  if (!profile.lanes_in_turn && !is_large(pass.domain, saved, share_loops(graph, heavy, profile))) return {};
  return saved < kWorthListing ? std::vector<ir::OpId>() : heavy;
}

std::vector<ir::OpId> unlikely_branches(const ir::Graph& graph, const Pass& pass, std::span<const ir::OpId> heavy,
                                        const target::Profile& profile) {
  const auto is_unlikely = [&](ir::OpId id) {
    const ir::OpId by = graph.value(graph.op(id).operands[0]).op;
    return by.valid() && graph.op(by).kind == ir::OpKind::Unlikely;
  };
  if (!profile.lanes_in_turn || std::ranges::all_of(heavy, is_unlikely)) return {};
  std::vector<ir::OpId> out;
  int saved = 0;
  for (const ir::OpId id : pass.ops) {
    const ir::Op& op = graph.op(id);
    if (op.kind != ir::OpKind::If || !is_unlikely(id)) continue;
    out.push_back(id);
    saved += region_cost(graph, op.regions[0]);
  }
  return saved < kWorthListing ? std::vector<ir::OpId>() : out;
}

bool share_loops(const ir::Graph& graph, std::span<const ir::OpId> heavy, const target::Profile& profile) {
  return profile.subgroup_shuffle && lanes_join(profile) && profile.loop_trips == 0 &&
         std::ranges::any_of(heavy, [&](ir::OpId id) {
           const ir::Op& op = graph.op(id);
           return op.kind == ir::OpKind::If && have_long_loop_in_any_order(graph, graph.region(op.regions[0]).ops);
         });
}

std::optional<ir::OpId> heavy_select(const ir::Graph& graph, const Pass& pass, std::span<const ir::ValueId> sinks,
                                     const Trips& trips, const target::Profile& profile) {
  if (!profile.lanes_in_turn || may_pass_limit(trips, profile)) return std::nullopt;
  Needed needed(graph, pass);
  const int all = needed.cost(sinks, std::nullopt, std::numeric_limits<int>::max());
  // What may be left at most: all - least >= kTimesLighter * (least + 1).
  const int most = (all - kTimesLighter) / (kTimesLighter + 1);
  int least = most + 1;
  std::optional<ir::OpId> best;
  std::set<ir::ValueId> conditions;
  for (const ir::OpId id : pass.ops) {
    const ir::Op& op = graph.op(id);
    if (op.kind != ir::OpKind::Select || graph.value(op.operands[0]).type != ir::kBool ||
        !conditions.insert(op.operands[0]).second)
      continue;
    if (const int without = needed.cost(sinks, id, least); without < least) best = id, least = without;
  }
  return all - least >= kWorthListing ? best : std::nullopt;
}

}  // namespace dr::backend
