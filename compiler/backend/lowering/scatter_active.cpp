// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/scatter_active.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "compiler/backend/analysis/uses.h"
#include "compiler/ir/yields.h"
#include "compiler/ops/op.h"

namespace dr::backend {

using ir::Graph;
using ir::Op;
using ir::OpKind;
using ir::ValueId;

namespace {

// Root values that are zero only where the value in question is; nothing: the value is zero everywhere.
using Zeros = std::optional<std::set<ValueId>>;

Zeros both(const Zeros& a, const Zeros& b) {
  if (!a) return b;
  if (!b) return a;
  std::set<ValueId> out;
  std::set_intersection(a->begin(), a->end(), b->begin(), b->end(), std::inserter(out, out.end()));
  return out;
}

class ActiveElements {
 public:
  ActiveElements(const Graph& graph, const Pass& pass)
      : graph_(graph), readable_(pass.reads.begin(), pass.reads.end()) {
    // Conditions that the pass computes itself are cheap.
    for (const ir::OpId id : pass.ops)
      for (const ValueId v : graph.op(id).results)
        if (graph.op(id).regions.empty() && graph.value(v).type.is_bool()) readable_.insert(v);
  }

  // The clause of a result: its op adds nothing to it unless all of these are true or not zero.
  std::vector<ValueId> clause(ValueId result) const {
    const Op& op = graph_.op(graph_.value(result).op);
    const uint32_t k = graph_.value(result).result_index;
    const Zeros zeros = op.kind == OpKind::ScatterAdd ? zero_with(op.operands[1]) : scattered(op, k);
    std::vector<ValueId> out;
    if (op.kind == OpKind::If && readable(op.operands[0]) && !scattered(op, op.regions[1], k))
      out.push_back(op.operands[0]);
    if (zeros)
      for (const ValueId v : *zeros)
        if (readable(v)) out.push_back(v);
    return out;
  }

 private:
  bool readable(ValueId v) const { return readable_.count(v) != 0 && graph_.value(v).region == graph_.root(); }

  // Where result `k` of a region op gets nothing but zeros.
  Zeros scattered(const Op& op, uint32_t k) const {
    Zeros zeros;
    for (const ir::RegionId region : ir::yielding_regions(op)) zeros = both(zeros, scattered(op, region, k));
    return zeros;
  }
  Zeros scattered(const Op& op, ir::RegionId region, uint32_t k) const {
    const ir::Yielded yield = ir::yielded(graph_, op, region)[k];
    if (yield.index.valid()) return zero_with(yield.value);
    const ir::ValueInfo& inner = graph_.value(yield.value);
    return scattered(graph_.op(inner.op), inner.result_index);
  }

  bool finite_constant(ValueId v) const {
    const ir::ValueInfo& info = graph_.value(v);
    if (!info.op.valid()) return false;
    const Op& op = graph_.op(info.op);
    return op.kind == OpKind::Const && !op.attrs.floats.empty() &&
           std::ranges::all_of(op.attrs.floats, [](double x) { return std::isfinite(x); });
  }

  // Each value is looked at once: values that are mixed of mixed ones have more ways to them than anybody can walk.
  const Zeros& zero_with(ValueId v) const {
    const auto found = known_.find(v);
    if (found != known_.end()) return found->second;
    Zeros zeros = find_zeros(v);
    return known_.emplace(v, std::move(zeros)).first->second;
  }
  Zeros find_zeros(ValueId v) const {
    const ir::ValueInfo& info = graph_.value(v);
    std::set<ValueId> self;
    if (info.region == graph_.root()) self.insert(v);
    if (!info.op.valid()) return self;
    const Op& op = graph_.op(info.op);
    const auto with_self = [&](Zeros zeros) {
      if (zeros) zeros->insert(self.begin(), self.end());
      return zeros;
    };
    switch (ops::info(op.kind).zero) {
      case ops::ZeroWhere::Unknown: break;
      case ops::ZeroWhere::ItsValueIs:
        if (std::ranges::all_of(op.attrs.floats, [](double x) { return x == 0; })) return std::nullopt;
        return std::set<ValueId>{};
      case ops::ZeroWhere::FirstIs: return with_self(zero_with(op.operands[0]));
      case ops::ZeroWhere::AllAre: {
        Zeros zeros;
        for (const ValueId part : op.operands) zeros = both(zeros, zero_with(part));
        return with_self(zeros);
      }
      case ops::ZeroWhere::AFactorIs:
        for (const size_t k : {0u, 1u})
          if (finite_constant(op.operands[1 - k])) return with_self(zero_with(op.operands[k]));
        break;
      case ops::ZeroWhere::BothSidesAre: {
        const ValueId yes = op.operands[1], no = op.operands[2];
        return with_self(or_asked(both(zero_with(yes), zero_with(no)), op.operands[0], yes, no));
      }
      case ops::ZeroWhere::BranchesAre: {
        Zeros zeros;
        if (op.attrs.yields[info.result_index] != ir::Yield::Element) break;
        for (const ir::RegionId region : op.regions)
          zeros = both(zeros, zero_with(ir::yielded(graph_, op, region)[info.result_index].value));
        if (op.kind == OpKind::If)
          zeros = or_asked(std::move(zeros), op.operands[0],
                           ir::yielded(graph_, op, op.regions[0])[info.result_index].value,
                           ir::yielded(graph_, op, op.regions[1])[info.result_index].value);
        return with_self(zeros);
      }
    }
    return self;
  }

  // Of a choice that asks whether a value is zero, and then is zero itself, those with which that one is, too:
  // if g != 0 { g * x } else { 0 }
  Zeros or_asked(Zeros zeros, ValueId condition, ValueId yes, ValueId no) const {
    const ir::OpId by = graph_.value(condition).op;
    if (!zeros || !by.valid()) return zeros;
    const Op& asks = graph_.op(by);
    if (asks.kind != OpKind::Equal && asks.kind != OpKind::NotEqual) return zeros;
    if (zero_with(asks.kind == OpKind::Equal ? yes : no)) return zeros;
    for (const size_t k : {0u, 1u})
      if (!zero_with(asks.operands[1 - k]))
        if (const Zeros& asked = zero_with(asks.operands[k])) zeros->insert(asked->begin(), asked->end());
    return zeros;
  }

  const Graph& graph_;
  std::set<ValueId> readable_;
  mutable std::map<ValueId, Zeros> known_;
};

}  // namespace

Clauses active_elements(const Graph& graph, const Pass& pass) {
  const std::vector<ScatterSum>& sums = pass.get<ScatterPass>().sums;
  if (pass.writes.size() != sums.size()) return {};
  const ActiveElements analysis(graph, pass);
  Clauses out;
  for (const ScatterSum& sum : sums)
    for (const ValueId term : sum.terms) {
      std::vector<ValueId> clause = analysis.clause(term);
      if (clause.empty()) return {};
      if (std::find(out.begin(), out.end(), clause) == out.end()) out.push_back(std::move(clause));
    }
  return out;
}

std::optional<PassId> find_lister(const ir::Graph& graph, const StepSchedule& step, size_t scatter,
                                  const Clauses& clauses) {
  const ir::Extent& domain = step.passes[scatter].domain;
  const auto computes = [&](const Pass& pass, ValueId v) {
    return std::ranges::find(pass.ops, graph.value(v).op) != pass.ops.end();
  };
  for (size_t k = scatter; k-- > 0;) {
    const Pass& pass = step.passes[k];
    if (!pass.is<MapPass>() || pass.domain != domain) continue;
    const bool all = std::ranges::all_of(clauses, [&](const std::vector<ValueId>& clause) {
      return std::ranges::all_of(clause, [&](ValueId v) { return computes(pass, v); });
    });
    if (all) return pass_id(k);
  }
  return std::nullopt;
}

std::set<ValueId> read_elsewhere(const Graph& graph, const Pass& pass) {
  std::set<ValueId> out;
  for (const ir::OpId id : pass.ops) {
    const Uses uses = uses_of(graph, graph.op(id));
    out.insert(uses.elsewhere.begin(), uses.elsewhere.end());
  }
  return out;
}

bool is_computed_by_then(const Graph& graph, const StepSchedule& step, PassId map, const Pass& scatter) {
  const std::set<ValueId> elsewhere = read_elsewhere(graph, scatter);
  if (std::ranges::any_of(step.pass(map).writes, [&](ValueId v) { return elsewhere.contains(v); })) return false;
  for (size_t k = map.index + 1; &step.passes[k] != &scatter; ++k)
    if (std::ranges::any_of(step.passes[k].writes, [&](ValueId v) { return contains(scatter.reads, v); })) return false;
  return true;
}

}  // namespace dr::backend
