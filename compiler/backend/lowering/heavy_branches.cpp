// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/heavy_branches.h"

#include <algorithm>
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
  Needed(const ir::Graph& graph, const Pass& pass) : graph_(graph), here_(pass.ops.begin(), pass.ops.end()) {}

  int cost(std::span<const ir::ValueId> sinks, std::optional<ir::OpId> select) {
    seen_.clear();
    cost_ = 0;
    const ir::ValueId no = select ? graph_.op(*select).operands[0] : ir::ValueId{};
    for (const ir::ValueId v : sinks)
      if (!select || !is_zero_without(graph_, v, {&*select, 1})) add(v, no);
    return cost_;
  }

 private:
  void add(ir::ValueId v, ir::ValueId no) {
    const ir::OpId id = graph_.value(v).op;
    if (!id.valid() || here_.count(id) == 0 || !seen_.insert(id).second) return;
    const ir::Op& op = graph_.op(id);
    if (op.kind == ir::OpKind::Select && op.operands[0] == no) {
      for (const size_t k : {size_t{0}, size_t{2}}) add(op.operands[k], no);
      return;
    }
    cost_ += whole_cost(graph_, op);
    const Uses uses = uses_of(graph_, op);
    for (const auto* list : {&uses.at_element, &uses.elsewhere})
      for (const ir::ValueId operand : *list) add(operand, no);
  }

  const ir::Graph& graph_;
  const std::set<ir::OpId> here_;
  std::set<ir::OpId> seen_;
  int cost_ = 0;
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
  const int all = needed.cost(sinks, std::nullopt);
  int least = all;
  std::optional<ir::OpId> best;
  std::set<ir::ValueId> conditions;
  for (const ir::OpId id : pass.ops) {
    const ir::Op& op = graph.op(id);
    if (op.kind != ir::OpKind::Select || graph.value(op.operands[0]).type != ir::kBool ||
        !conditions.insert(op.operands[0]).second)
      continue;
    if (const int without = needed.cost(sinks, id); without < least) best = id, least = without;
  }
  const int saved = all - least;
  return saved >= kWorthListing && saved >= kTimesLighter * (least + 1) ? best : std::nullopt;
}

}  // namespace dr::backend
