// SPDX-License-Identifier: Apache-2.0
// Terms that are scattered stand together in a sum, by the elements that they come from, and of these by the op that
// scatters them: the backend adds up what one pass scatters as one sum, which rounds once.
//   %3 = add %x, %s1 ; %4 = add %3, %s2    =>    %3 = add %s1, %s2 ; %4 = add %x, %3
// Of a larger sum only the part changes that all of them stand in.
// This is the one place where the order of additions changes: how scattered terms are summed is the compiler's choice.
// Requires: no Grad op.
#include <algorithm>
#include <map>
#include <optional>
#include <set>

#include "compiler/passes/copy_steps.h"
#include "compiler/passes/passes.h"

namespace dr::passes {

using namespace ir;

namespace {

class Grouper {
 public:
  explicit Grouper(const Graph& from)
      : from_(from),
        map_(from.value_count()),
        uses_(from.value_count()),
        adds_scattered_(from.value_count()),
        inner_(from.op_count()) {
    for (const Step& step : from.steps) {
      for (const Output& output : step.outputs) ++uses_[output.value.index];
      for (const Update& update : step.updates) ++uses_[update.value.index];
    }
    const std::vector<OpId>& ops = from.region(from.root()).ops;
    for (const OpId id : ops) {
      for (const ValueId v : from.op(id).operands) ++uses_[v.index];
      for (const RegionId region : from.op(id).regions)
        for (const ValueId v : captures(from, region)) ++uses_[v.index];
    }
    for (const OpId id : ops)
      if (const Op& op = from.op(id); op.kind == OpKind::Add)
        adds_scattered_[op.results[0].index] =
            std::ranges::any_of(op.operands, [&](ValueId v) { return has_scattered(v, from.value(op.results[0])); });
    // Users first: what another sum adds up is part of that one.
    for (size_t k = ops.size(); k-- > 0;)
      if (from.op(ops[k]).kind == OpKind::Add && !inner_[ops[k].index]) find_terms(from.op(ops[k]));
  }

  Graph run() {
    to_.reserve(from_.op_count());
    to_.graph().leaves = from_.leaves;
    for (const OpId id : from_.region(from_.root()).ops) {
      if (inner_[id.index]) continue;
      if (const auto sum = sums_.find(id); sum != sums_.end())
        rebuild(from_.op(id), sum->second);
      else
        copy_op(from_, id, to_, map_);
    }
    to_.graph().steps = copy_steps(from_, map_);
    return std::move(to_).finish();
  }

 private:
  using Terms = std::vector<ValueId>;

  // The domain of what scatters a value; nothing where it is no sum of scattered terms.
  std::optional<Extent> scattered_over(ValueId v) const {
    const Op& op = from_.op(from_.value(v).op);
    if (op.kind == OpKind::ScatterAdd)
      return broadcast(from_.value(op.operands[0]).extent, from_.value(op.operands[1]).extent);
    const uint32_t k = from_.value(v).result_index;
    if (k >= op.attrs.yields.size() || op.attrs.yields[k] != Yield::Scatter) return std::nullopt;
    return Extent{op.attrs.dims[0], op.attrs.dims[1], op.attrs.dims[2]};
  }

  // An addition that nothing but that of `sum` uses.
  bool is_part(ValueId v, const ValueInfo& sum) const {
    const ValueInfo& part = from_.value(v);
    return from_.op(part.op).kind == OpKind::Add && uses_[v.index] == 1 && part.type == sum.type &&
           part.extent == sum.extent;
  }

  // Whether an operand of that addition is, or adds up, something that is scattered.
  bool has_scattered(ValueId v, const ValueInfo& sum) const {
    return is_part(v, sum) ? adds_scattered_[v.index] : scattered_over(v).has_value();
  }

  void find_terms(const Op& root) {
    const ValueInfo& sum = from_.value(root.results[0]);
    if (!std::ranges::all_of(root.operands, [&](ValueId v) { return has_scattered(v, sum); })) return;
    Terms terms;
    std::vector<OpId> adds;
    collect(root, terms, adds);
    std::set<std::optional<Extent>> kinds;
    std::set<OpId> by;
    bool groups = false;
    for (const ValueId v : terms) {
      const auto domain = scattered_over(v);
      if (!kinds.insert(domain).second && domain) groups = true;
      if (domain) by.insert(from_.value(v).op);
    }
    // None to group, or nothing else beside them.
    if (!groups || (kinds.size() < 2 && (by.size() < 2 || by.size() == terms.size()))) return;
    for (const OpId id : adds) inner_[id.index] = true;
    sums_.emplace(from_.value(root.results[0]).op, std::move(terms));
  }

  // The terms of a sum in order, through additions that nothing else uses.
  void collect(const Op& add, Terms& terms, std::vector<OpId>& adds) const {
    const ValueInfo& sum = from_.value(add.results[0]);
    for (const ValueId v : add.operands) {
      if (is_part(v, sum)) {
        adds.push_back(from_.value(v).op);
        collect(from_.op(from_.value(v).op), terms, adds);
      } else {
        terms.push_back(v);
      }
    }
  }

  void rebuild(const Op& root, const Terms& terms) {
    const ValueInfo& info = from_.value(root.results[0]);
    const auto add = [&](std::optional<ValueId>& to, ValueId v) {
      if (!to) {
        to = v;
        return;
      }
      // A term may be smaller than the sum, and stretch.
      const ResultType type{info.type, *broadcast(to_.value(*to).extent, to_.value(v).extent)};
      const OpId op = to_.add(OpKind::Add, {*to, v}, std::span(&type, 1), {}, {}, root.span);
      to = to_.graph().op(op).results[0];
    };
    std::optional<ValueId> sum;
    std::map<Extent, std::map<OpId, std::optional<ValueId>>> groups;
    for (const ValueId v : terms)
      if (const auto domain = scattered_over(v))
        add(groups[*domain][from_.value(v).op], map_[v]);
      else
        add(sum, map_[v]);
    for (const auto& [domain, ops] : groups) {
      std::optional<ValueId> group;
      for (const auto& [op, of_op] : ops) add(group, *of_op);
      add(sum, *group);
    }
    map_.set(root.results[0], *sum);
    if (!info.name.empty()) to_.set_name(*sum, info.name);
  }

  const Graph& from_;
  Builder to_;
  ValueMap map_;
  std::vector<int> uses_;             // of root values
  std::vector<bool> adds_scattered_;  // by value of the root
  std::vector<bool> inner_;           // additions that are part of a larger sum, by OpId index
  std::map<OpId, Terms> sums_;        // by their last addition
};

}  // namespace

Graph group_sums(const Graph& graph, const Skips& /*skips*/) { return Grouper(graph).run(); }

}  // namespace dr::passes
