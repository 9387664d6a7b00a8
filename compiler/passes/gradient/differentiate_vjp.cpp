// SPDX-License-Identifier: Apache-2.0
// Gradients that the program gives itself. A Vjp op holds the ops of its targets' adjoints beside its value, written in
// terms of a Cotangent that stands for the adjoint of the value:
//   %2 = cotangent           %3 = mul %2, %x              %4 = vjp %y, %2, %x, %3
// When the sweep meets the op with an adjoint %a of %4, it copies what depends on the cotangent with %a in its place:
//   %5 = mul %a, %x
// These copies are ordinary ops, so gradients of gradients need nothing more. In the end the Vjp is its value, and what
// depends on cotangents is dropped: nothing else may use it.
#include <algorithm>
#include <set>
#include <utility>

#include "compiler/ops/emit.h"
#include "compiler/passes/copy_steps.h"
#include "compiler/passes/gradient/differentiate.h"

namespace dr::passes {

using ir::Builder;
using ir::Extent;
using ir::Graph;
using ir::Op;
using ir::OpId;
using ir::OpKind;
using ir::RegionId;
using ir::ResultType;
using ir::ValueId;
using ir::ValueMap;

namespace {

// Which values depend on a cotangent. A region op does if its operands do or what its regions yield.
class Dependence {
 public:
  explicit Dependence(const Graph& graph) : graph_(graph) {}

  bool has(ValueId value) const { return values_.contains(value); }

  // Enters the op's results; ops are to be visited in order. Gives whether they depend.
  bool visit(OpId id) {
    const Op& op = graph_.op(id);
    // A Vjp's operands after the first are about gradients; its value is that of the first.
    bool depends = op.kind == OpKind::Cotangent || (op.kind == OpKind::Vjp ? has(op.operands[0]) : any(op.operands));
    for (const RegionId region : op.regions) {
      for (const OpId inner : graph_.region(region).ops) visit(inner);
      depends = depends || any(graph_.region(region).yields);
    }
    if (depends) values_.insert(op.results.begin(), op.results.end());
    return depends;
  }

 private:
  bool any(const std::vector<ValueId>& values) const {
    return std::ranges::any_of(values, [&](ValueId value) { return has(value); });
  }

  const Graph& graph_;
  std::set<ValueId> values_;
};

// Copies an op whose operands may have other extents than they had, so that its results are inferred anew. A region op
// runs over `domain` where one is given.
void copy_inferred(const Graph& from, OpId id, Builder& to, ValueMap& map, const Extent* domain) {
  const Op& op = from.op(id);
  std::vector<RegionId> regions;
  for (const RegionId old : op.regions) {
    std::vector<ResultType> params;
    for (const ValueId param : from.region(old).params) {
      params.push_back({.type = from.value(param).type, .extent = domain ? *domain : from.value(param).extent});
    }
    const RegionId now = to.begin_region(params);
    for (size_t i = 0; i < params.size(); ++i) map.set(from.region(old).params[i], to.graph().region(now).params[i]);
    for (const OpId inner : from.region(old).ops) copy_inferred(from, inner, to, map, domain);
    std::vector<ValueId> yields;
    for (const ValueId yield : from.region(old).yields) yields.push_back(map[yield]);
    to.end_region(std::move(yields));
    regions.push_back(now);
  }
  if (op.kind == OpKind::Const) return ir::copy_op(from, id, to, map);
  std::vector<ValueId> operands;
  for (const ValueId operand : op.operands) operands.push_back(map[operand]);
  ir::Attrs attrs = op.attrs;
  if (domain && !op.regions.empty()) {
    attrs.dims[0] = domain->w;
    attrs.dims[1] = domain->h;
    attrs.dims[2] = domain->l;
  }
  const std::vector<ValueId> results =
      ops::emit_multi(to, op.kind, std::move(operands), std::move(attrs), std::move(regions));
  for (size_t k = 0; k < results.size(); ++k) map.set(op.results[k], results[k]);
}

class Dropper {
 public:
  explicit Dropper(const Graph& from) : from_(from), map_(from.value_count()), dependence_(from) {}

  Graph run() && {
    to_.graph().leaves = from_.leaves;
    for (const OpId id : from_.region(from_.root()).ops) copy(id);
    to_.graph().steps = copy_steps(from_, map_);
    return std::move(to_).finish();
  }

 private:
  void copy(OpId id) {
    const Op& op = from_.op(id);
    if (dependence_.visit(id)) return;
    if (op.kind == OpKind::Vjp) return map_.set(op.results[0], map_[op.operands[0]]);
    if (op.regions.empty()) return ir::copy_op(from_, id, to_, map_);
    std::vector<RegionId> regions;
    for (const RegionId old : op.regions) {
      std::vector<ResultType> params;
      for (const ValueId param : from_.region(old).params) params.push_back(type_of(param));
      const RegionId now = to_.begin_region(params);
      for (size_t i = 0; i < params.size(); ++i) enter(from_.region(old).params[i], to_.graph().region(now).params[i]);
      for (const OpId inner : from_.region(old).ops) copy(inner);
      to_.end_region(mapped(from_.region(old).yields));
      regions.push_back(now);
    }
    std::vector<ResultType> types;
    for (const ValueId result : op.results) types.push_back(type_of(result));
    const OpId now = to_.add(op.kind, mapped(op.operands), types, op.attrs, std::move(regions), op.span);
    for (size_t k = 0; k < op.results.size(); ++k) enter(op.results[k], to_.graph().op(now).results[k]);
  }

  ResultType type_of(ValueId id) const {
    const ir::ValueInfo& info = from_.value(id);
    return {.type = info.type, .extent = info.extent, .accumulation = info.accumulation};
  }
  std::vector<ValueId> mapped(const std::vector<ValueId>& values) const {
    std::vector<ValueId> out;
    for (const ValueId value : values) out.push_back(map_[value]);
    return out;
  }
  void enter(ValueId old, ValueId now) {
    map_.set(old, now);
    to_.set_name(now, from_.value(old).name);
  }

  const Graph& from_;
  Builder to_;
  ValueMap map_;
  Dependence dependence_;
};

}  // namespace

void differentiate_vjp(Sweep& sweep, Frame& frame, const Op& op) {
  const auto found = frame.adjoints.find(op.results[0]);
  if (found == frame.adjoints.end()) return;
  const std::span<const ValueId> operands = op.operands;
  const size_t count = (operands.size() - 2) / 2;
  const std::span<const ValueId> targets = operands.subspan(2, count), adjoints = operands.subspan(2 + count);

  Builder& b = sweep.builder;
  const Graph& source = sweep.source;
  const Extent& extent = source.value(op.results[0]).extent;
  const ValueId given = frame.root ? ops::broadcast(b, found->second, extent) : found->second;

  // From the cotangent to this op: what depends on it, and of that what active targets need.
  const std::vector<OpId>& all = source.region(op.parent).ops;
  const ir::ValueInfo& cotangent = source.value(operands[1]);
  const auto first = std::ranges::lower_bound(all, cotangent.op),
             last = std::ranges::lower_bound(all, source.value(op.results[0]).op);
  Dependence dependence(source);
  for (auto it = first; it != last; ++it) dependence.visit(*it);
  std::set<ValueId> needed;
  for (size_t k = 0; k < count; ++k)
    if (sweep.active[targets[k].index]) needed.insert(adjoints[k]);
  std::vector<OpId> list;
  for (auto it = last; it != first; --it) {
    const Op& other = source.op(*std::prev(it));
    if (std::ranges::none_of(other.results, [&](ValueId id) { return needed.contains(id) && dependence.has(id); }))
      continue;
    list.push_back(*std::prev(it));
    needed.insert(other.operands.begin(), other.operands.end());
    for (const RegionId region : other.regions) {
      const std::vector<ValueId> captured = ir::captures(source, region);
      needed.insert(captured.begin(), captured.end());
    }
  }
  std::ranges::reverse(list);

  std::vector<std::pair<ValueId, ValueId>> before;
  for (const OpId id : list) {
    for (const ValueId result : source.op(id).results) before.emplace_back(result, sweep.now[result]);
    if (id == cotangent.op) {
      sweep.now.set(operands[1], given);
    } else {
      copy_inferred(source, id, b, sweep.now, frame.root ? nullptr : &frame.domain);
    }
  }
  std::vector<ValueId> terms;
  for (const ValueId adjoint : adjoints) terms.push_back(sweep.now[adjoint]);
  for (const auto& [value, now] : before) sweep.now.set(value, now);

  for (size_t k = 0; k < count; ++k) {
    if (!sweep.active[targets[k].index]) continue;
    ValueId term = terms[k];
    const Extent& wanted = source.value(targets[k]).extent;
    if (frame.root && b.value(term).extent != wanted && !is_zero(b.graph(), term)) {
      if (const auto both = ir::broadcast(b.value(term).extent, wanted)) term = ops::broadcast(b, term, *both);
      term = ops::reduce_to(b, term, wanted);
    }
    sweep.add(frame, targets[k], term);
  }
}

Graph drop_vjps(Graph graph) {
  for (size_t k = 0; k < graph.op_count(); ++k) {
    if (graph.op(OpId{static_cast<uint32_t>(k)}).kind == OpKind::Vjp) return Dropper(graph).run();
  }
  return graph;
}

}  // namespace dr::passes
