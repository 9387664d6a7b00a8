// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/analysis/same_in_run.h"

#include <algorithm>
#include <bit>

#include "compiler/backend/analysis/form.h"
#include "compiler/backend/analysis/uses.h"
#include "compiler/ops/op.h"

namespace dr::backend {

using ir::Graph;
using ir::Op;
using ir::OpKind;
using ir::ValueId;

std::vector<ir::OpId> reads_of_runs(const Graph& graph, std::span<const ir::OpId> ops, const ir::Dim& width, int run,
                                    const std::set<ValueId>& but) {
  if (!width.is_constant() || width.constant() % run != 0) return {};
  const int bits = std::countr_zero(static_cast<unsigned>(run));
  const Form form(graph);
  std::set<ValueId> same;
  std::vector<ValueId> reads;
  for (const ir::OpId id : ops) {
    const Op& op = graph.op(id);
    const bool plain = op.regions.empty() && op.results.size() == 1 && !but.contains(op.results[0]);
    const auto is_same = [&](ValueId v) { return same.contains(v); };
    const bool reads_one = op.kind == OpKind::Gather && is_same(op.operands[1]);
    const bool is_made = ops::info(op.kind).reads.value_or(ops::Reads::AtElement) == ops::Reads::AtElement &&
                         !op.operands.empty() && std::ranges::all_of(op.operands, is_same);
    const bool is_place = op.kind == OpKind::Coord && op.attrs.ints[0] != 0;
    const bool is_number = op.kind == OpKind::Const || op.kind == OpKind::DimValue;
    if (!plain || !(is_place || is_number || reads_one || is_made || form.is_number_of_run(op, bits))) continue;
    same.insert(op.results[0]);
    if (reads_one) reads.push_back(op.results[0]);
  }
  return reads.empty() ? std::vector<ir::OpId>() : ops_of(graph, ops, reads);
}

}  // namespace dr::backend
