// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/heavy_branches.h"

#include "compiler/backend/cost/cost.h"
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

int region_cost(const ir::Graph& graph, ir::RegionId region) {
  int cost = 0;
  for (const ir::OpId id : graph.region(region).ops) {
    const ir::Op& op = graph.op(id);
    cost += op.regions.empty() ? op_cost(op.kind) : 0;
    for (const ir::RegionId inner : op.regions)
      cost += region_cost(graph, inner) * (ir::is_loop(op.kind) ? kLoopTrips : 1);
  }
  return cost;
}

// Whether there surely are more elements than a GPU runs at once. A heavy branch needs registers, so that fewer run at
// once, whether they take it or not; a dispatch more costs as much as some hundred thousand elements. Loops within
// loops need them all.
bool is_large(const ir::Extent& domain, int saved) {
  constexpr int kManyRegisters = 1 << 16;
  const int64_t kLarge = saved < kManyRegisters ? 1 << 20 : 1 << 18;
  const auto elements = (domain.w * domain.h * domain.l).evaluate({});
  return elements && *elements >= kLarge;
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
  if (!profile.lanes_in_turn && !is_large(pass.domain, saved)) return {};
  return saved < kWorthListing ? std::vector<ir::OpId>() : heavy;
}

}  // namespace dr::backend
