// SPDX-License-Identifier: Apache-2.0
#include "compiler/lower/program/zeros.h"

#include <algorithm>

#include "compiler/ops/op.h"

namespace dr::lower {

using namespace ir;

namespace {

// As a device has them: the float32 nearest to each.
std::vector<double> rounded(std::vector<double> components, const Type& type) {
  if (type.is_float())
    for (double& x : components) x = static_cast<double>(static_cast<float>(x));
  return components;
}

}  // namespace

bool Zeros::is_zero(ValueId id) {
  // Operands come before what is made of them.
  while (facts_.size() <= id.index) facts_.push_back(fact_of({static_cast<uint32_t>(facts_.size())}));
  if (!facts_[id.index].is_zero) return false;
  Answer answer;
  std::vector<ValueId> open{id};
  while (!open.empty()) {
    const ValueId value = open.back();
    open.pop_back();
    if (!answer.values.insert(value).second) continue;
    const Op& op = graph_.op(graph_.value(value).op);
    if (op.kind == OpKind::Leaf) answer.leaves.insert(*graph_.leaf_index(op.attrs.text));
    open.insert(open.end(), facts_[value.index].from.begin(), facts_[value.index].from.end());
  }
  used_.insert(answer.leaves.begin(), answer.leaves.end());
  if (!answer.leaves.empty()) answers_.push_back(std::move(answer));
  return true;
}

std::set<uint32_t> Zeros::sought() const {
  std::set<ValueId> targets;
  for (uint32_t k = 0; k < graph_.op_count(); ++k)
    if (const Op& op = graph_.op({k}); op.kind == OpKind::Grad)
      targets.insert(op.operands.begin() + 2, op.operands.end());
  std::set<uint32_t> out;
  for (const Answer& answer : answers_)
    if (std::ranges::any_of(targets, [&](ValueId id) { return answer.values.contains(id); }))
      out.insert(answer.leaves.begin(), answer.leaves.end());
  return out;
}

Zeros::Fact Zeros::fact_of(ValueId id) const {
  const ValueInfo& value = graph_.value(id);
  if (!value.op.valid()) return {};  // a region's
  const Op& op = graph_.op(value.op);
  Fact fact;
  fact.number = number_of(op, value.type);
  if (fact.number) {
    fact.is_zero = std::ranges::all_of(*fact.number, [](double x) { return x == 0; });
    fact.from = op.operands;
    return fact;
  }
  const auto rests_on = [&](std::span<const ValueId> operands) {
    fact.is_zero = std::ranges::all_of(operands, [&](ValueId x) { return facts_[x.index].is_zero; });
    if (fact.is_zero) fact.from.assign(operands.begin(), operands.end());
  };
  static constexpr OpKind kProducts[] = {OpKind::Mul, OpKind::SMul, OpKind::Dot};
  static constexpr OpKind kOfAll[] = {OpKind::Add, OpKind::Sub,   OpKind::Min,     OpKind::Max,     OpKind::Neg,
                                      OpKind::Abs, OpKind::Splat, OpKind::Compose, OpKind::Extract, OpKind::Broadcast};
  const std::span<const ValueId> all = op.operands;
  if (std::ranges::find(kProducts, op.kind) != std::end(kProducts)) {
    for (size_t k = 0; k < 2 && !fact.is_zero; ++k) rests_on(all.subspan(k, 1));
  } else if (op.kind == OpKind::Div) {
    rests_on(all.first(1));
  } else if (op.kind == OpKind::Select) {
    rests_on(all.subspan(1));
  } else if (std::ranges::find(kOfAll, op.kind) != std::end(kOfAll)) {
    rests_on(all);
  }
  return fact;
}

std::optional<std::vector<double>> Zeros::number_of(const Op& op, const Type& type) const {
  if (op.kind == OpKind::Const) return rounded(op.attrs.floats, type);
  if (op.kind == OpKind::Leaf) {
    const auto leaf = graph_.leaf_index(op.attrs.text);
    if (!leaf || !fixed_.contains(*leaf)) return std::nullopt;
    return rounded(graph_.leaves[*leaf].initial, type);
  }
  const ops::OpInfo& info = ops::info(op.kind);
  if (info.shape != ops::Shape::Elementwise || !info.eval || op.operands.empty() ||
      !std::ranges::all_of(op.operands, [&](ValueId x) { return has_number(x); }))
    return std::nullopt;
  std::vector<const double*> planes;
  std::vector<Type> types;
  for (const ValueId operand : op.operands) {
    planes.push_back(facts_[operand.index].number->data());
    types.push_back(graph_.value(operand).type);
  }
  std::vector<double> result(static_cast<size_t>(type.components()));
  info.eval({.n = 1,
             .operands = planes,
             .operand_types = types,
             .attrs = op.attrs,
             .result_type = type,
             .result = result.data()});
  return rounded(std::move(result), type);
}

}  // namespace dr::lower
