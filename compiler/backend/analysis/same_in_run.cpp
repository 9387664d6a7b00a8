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

std::vector<ir::OpId> RunReads::ops() const {
  std::vector<ir::OpId> out = same;
  for (const ReadsBeside& read : beside)
    for (const auto& op : {read.before, read.after})
      if (op) out.push_back(*op);
  return out;
}

std::vector<ReadsBeside> reads_beside(const Graph& graph, std::span<const ir::OpId> ops, const ir::Extent& domain,
                                      int run) {
  if (!domain.w.is_constant() || !domain.h.is_constant() || domain.w.constant() % run != 0) return {};
  const Form form(graph);
  const auto is_pair = [&](ValueId v, double x, double y) {
    const Op* op = form.made_by(v, OpKind::Const);
    return op != nullptr && op->attrs.floats == std::vector{x, y};
  };
  const auto is_own_place = [&](ValueId v) {
    const Op* op = form.made_by(v, OpKind::Compose);
    return op != nullptr && op->operands.size() == 2 && form.is_place(op->operands[0], 0) &&
           form.is_place(op->operands[1], 1);
  };
  const auto is_beside = [&](ValueId place, int by) {
    const Op* held = form.made_by(place, OpKind::Clamp);
    return held != nullptr && is_pair(held->operands[1], 0, 0) &&
           is_pair(held->operands[2], static_cast<double>(domain.w.constant() - 1),
                   static_cast<double>(domain.h.constant() - 1)) &&
           form.is_both(held->operands[0], OpKind::Add, is_own_place, [&](ValueId v) { return is_pair(v, by, 0); });
  };
  std::vector<ReadsBeside> out;
  for (const ir::OpId id : ops) {
    const Op& op = graph.op(id);
    if (op.kind != OpKind::Gather || graph.value(op.operands[0]).extent != domain) continue;
    const bool before = is_beside(op.operands[1], -1);
    if (!before && !is_beside(op.operands[1], 1)) continue;
    auto found = std::ranges::find(out, op.operands[0], &ReadsBeside::value);
    if (found == out.end()) found = out.insert(out.end(), {op.operands[0], {}, {}});
    (before ? found->before : found->after) = id;
  }
  return out;
}

}  // namespace dr::backend
