// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/analysis/zero_without.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <map>
#include <optional>
#include <set>

#include "compiler/ir/yields.h"
#include "compiler/ops/op.h"

namespace dr::backend {

using ir::Op;
using ir::OpKind;
using ir::ValueId;

namespace {

class Zeros {
 public:
  Zeros(const ir::Graph& graph, std::span<const ir::OpId> branches) : graph_(graph) {
    for (const ir::OpId id : branches) conditions_.insert(graph.op(id).operands[0]);
  }

  bool has(ValueId v) {
    const auto [at, is_new] = known_.emplace(v, false);
    if (is_new) known_[v] = find(v);
    return known_[v];
  }

 private:
  bool find(ValueId v) {
    const ir::ValueInfo& info = graph_.value(v);
    if (!info.op.valid()) return false;
    const Op& op = graph_.op(info.op);
    if (op.kind == OpKind::If && conditions_.contains(op.operands[0]))
      return has(ir::yielded(graph_, op, op.regions[1])[info.result_index].value);
    if (op.kind == OpKind::Select && conditions_.contains(op.operands[0])) return has(op.operands[2]);
    if (const auto taken = branch_by_zero(op)) {
      const size_t branch = *taken ? 0 : 1;
      return op.kind == OpKind::Select ? has(op.operands[1 + branch])
                                       : has(ir::yielded(graph_, op, op.regions[branch])[info.result_index].value);
    }
    switch (ops::info(op.kind).zero) {
      case ops::ZeroWhere::Unknown:
        return op.kind == OpKind::Div && graph_.value(v).type.is_float() && has(op.operands[0]) &&
               is_positive(op.operands[1]);
      case ops::ZeroWhere::ItsValueIs: return std::ranges::all_of(op.attrs.floats, [](double x) { return x == 0; });
      case ops::ZeroWhere::FirstIs: return has(op.operands[0]);
      case ops::ZeroWhere::AllAre: return std::ranges::all_of(op.operands, [&](ValueId part) { return has(part); });
      case ops::ZeroWhere::AFactorIs:
        return (is_finite(op.operands[1]) && has(op.operands[0])) || (is_finite(op.operands[0]) && has(op.operands[1]));
      case ops::ZeroWhere::BothSidesAre: return has(op.operands[1]) && has(op.operands[2]);
      case ops::ZeroWhere::BranchesAre:
        return op.attrs.yields[info.result_index] == ir::Yield::Element &&
               std::ranges::all_of(op.regions, [&](ir::RegionId region) {
                 return has(ir::yielded(graph_, op, region)[info.result_index].value);
               });
    }
    return false;
  }

  // Which branch an `if` or a select takes that asks whether something is zero, which it is:  if g != 0 { g * x }
  std::optional<bool> branch_by_zero(const Op& op) {
    const bool element = op.kind == OpKind::Select && graph_.value(op.operands[0]).type == ir::kBool;
    if (!element && op.kind != OpKind::If) return std::nullopt;
    const ir::OpId by = graph_.value(op.operands[0]).op;
    if (!by.valid()) return std::nullopt;
    const Op& asks = graph_.op(by);
    if (asks.kind != OpKind::Equal && asks.kind != OpKind::NotEqual) return std::nullopt;
    for (const size_t k : {size_t{0}, size_t{1}})
      if (is_zero(asks.operands[1 - k]) && has(asks.operands[k])) return asks.kind == OpKind::Equal;
    return std::nullopt;
  }

  bool is_finite(ValueId v) const {
    const ir::ValueInfo& info = graph_.value(v);
    if (!info.op.valid() || graph_.op(info.op).kind != OpKind::Const) return false;
    return std::ranges::all_of(graph_.op(info.op).attrs.floats, [](double x) { return std::isfinite(x); });
  }

  // Or +Inf, but no NaN:  select(0 < x, x, 1)
  bool is_positive(ValueId v) const {
    const ir::ValueInfo& info = graph_.value(v);
    if (!info.op.valid()) return false;
    const Op& op = graph_.op(info.op);
    if (op.kind == OpKind::Const) return std::ranges::all_of(op.attrs.floats, [](double x) { return x > 0; });
    if (is_same(op.kind)) return is_positive(op.operands[0]);
    if (op.kind != OpKind::Select) return false;
    const ir::ValueInfo& by = graph_.value(op.operands[0]);
    if (!by.op.valid() || graph_.op(by.op).kind != OpKind::Less) return false;
    const Op& compared = graph_.op(by.op);
    return compared.operands[1] == op.operands[1] && is_zero(compared.operands[0]) && is_positive(op.operands[2]);
  }

  // Each component is the operand, or one of its own.
  static bool is_same(OpKind kind) {
    return kind == OpKind::Broadcast || kind == OpKind::Splat || kind == OpKind::Pin || kind == OpKind::Detach;
  }

  bool is_zero(ValueId v) const {
    const ir::ValueInfo& info = graph_.value(v);
    if (!info.op.valid()) return false;
    const Op& op = graph_.op(info.op);
    if (is_same(op.kind)) return is_zero(op.operands[0]);
    return op.kind == OpKind::Const && std::ranges::all_of(op.attrs.floats, [](double x) { return x == 0; });
  }

  const ir::Graph& graph_;
  std::set<ValueId> conditions_;
  std::map<ValueId, bool> known_;
};

// Ops that give the same for a zero of either sign, or zeros of either sign. Of Div that holds for the first operand.
constexpr OpKind kBlindToSigns[] = {
    OpKind::Add,        OpKind::Sub,    OpKind::Mul,  OpKind::SMul,    OpKind::Div,      OpKind::Neg,
    OpKind::Abs,        OpKind::Dot,    OpKind::Less, OpKind::Equal,   OpKind::NotEqual, OpKind::LessEqual,
    OpKind::Select,     OpKind::Splat,  OpKind::Pin,  OpKind::Compose, OpKind::Extract,  OpKind::Broadcast,
    OpKind::ScatterAdd, OpKind::Detach, OpKind::If,   OpKind::Reduce,  OpKind::Fold};

// Adds the values of which the sign of a zero may show, given those of which it does, to the end of `ops`.
void find_signs(const ir::Graph& graph, std::span<const ir::OpId> ops, std::set<ValueId>& signs) {
  for (size_t k = ops.size(); k-- > 0;) {
    const Op& op = graph.op(ops[k]);
    const auto all = [&] {
      const std::vector<ValueId> needs = ir::needs_of(graph, op);
      signs.insert(needs.begin(), needs.end());
    };
    if (std::ranges::any_of(op.results, [&](ValueId v) { return signs.contains(v); })) {
      all();
    } else if (std::ranges::find(kBlindToSigns, op.kind) == std::end(kBlindToSigns)) {
      signs.insert(op.operands.begin(), op.operands.end());
    } else if (op.kind == OpKind::Div) {
      signs.insert(op.operands[1]);
    }
    for (const ir::RegionId region : op.regions) {
      find_signs(graph, graph.region(region).ops, signs);
      // What a loop carries on comes from all that it is made of.
      if (std::ranges::any_of(graph.region(region).params, [&](ValueId v) { return signs.contains(v); })) all();
    }
  }
}

}  // namespace

bool is_zero_without(const ir::Graph& graph, ValueId value, std::span<const ir::OpId> branches) {
  return Zeros(graph, branches).has(value);
}

std::vector<ir::OpId> zeros_without(const ir::Graph& graph, std::span<const ir::OpId> ops,
                                    std::span<const ir::OpId> branches, std::span<const ir::ValueId> shown) {
  std::set<ValueId> signs(shown.begin(), shown.end());
  find_signs(graph, ops, signs);
  Zeros zeros(graph, branches);
  std::vector<ir::OpId> out;
  std::ranges::copy_if(ops, std::back_inserter(out), [&](ir::OpId id) {
    return std::ranges::all_of(graph.op(id).results, [&](ValueId v) {
      return graph.value(v).type.is_float() && !signs.contains(v) && zeros.has(v);
    });
  });
  return out;
}

}  // namespace dr::backend
