// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/unite_passes.h"

#include <algorithm>

#include "compiler/backend/analysis/uses.h"

namespace dr::backend {

Pass united(const ir::Graph& graph, const StepSchedule& step, const std::set<size_t>& group) {
  Pass out = step.passes[*group.begin()];
  std::set<ir::OpId> ops;
  std::set<ir::ValueId> reads, writes;
  std::vector<ScatterSum> sums;
  out.name.clear();
  for (const size_t k : group) {
    const Pass& pass = step.passes[k];
    ops.insert(pass.ops.begin(), pass.ops.end());
    reads.insert(pass.reads.begin(), pass.reads.end());
    writes.insert(pass.writes.begin(), pass.writes.end());
    const auto& own = pass.get<ScatterPass>().sums;
    sums.insert(sums.end(), own.begin(), own.end());
    out.name += (out.name.empty() ? "" : "_") + pass.name;
  }
  std::ranges::sort(sums, {}, &ScatterSum::value);
  out.ops = in_order(graph, ops);
  out.reads.assign(reads.begin(), reads.end());
  out.writes.assign(writes.begin(), writes.end());
  out.get<ScatterPass>().sums = std::move(sums);
  return out;
}

void put_in_place_of(const std::set<size_t>& group, Pass pass, StepSchedule& step) {
  for (const size_t k : group) step.passes[k] = {};
  step.passes[*group.begin()] = std::move(pass);
}

}  // namespace dr::backend
