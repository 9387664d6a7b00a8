// SPDX-License-Identifier: Apache-2.0
// Uses of values, op by op.
#include "compiler/backend/analysis/uses.h"

#include <algorithm>
#include <iterator>
#include <set>
#include <string>

#include "compiler/ops/op.h"

namespace dr::backend {

using ir::Graph;
using ir::Op;
using ir::OpId;
using ir::OpKind;
using ir::ValueId;

bool is_inline(const Op& op) {
  return op.kind == OpKind::Const || op.kind == OpKind::DimValue || op.kind == OpKind::Coord;
}

bool is_memory(const Op& op) { return op.kind == OpKind::Leaf || op.kind == OpKind::StepIndex; }

namespace {

void add_region_uses(const Graph& graph, ir::RegionId region, Uses& uses) {
  auto is_root = [&](ValueId v) { return graph.value(v).region == graph.root(); };
  for (OpId id : graph.region(region).ops) {
    const Op& op = graph.op(id);
    for (size_t k = 0; k < op.operands.size(); ++k) {
      if (!is_root(op.operands[k])) continue;
      (k == 0 && ops::info(op.kind).reads == ops::Reads::FirstElsewhere ? uses.elsewhere : uses.at_element)
          .push_back(op.operands[k]);
    }
    for (ir::RegionId inner : op.regions) add_region_uses(graph, inner, uses);
  }
  for (ValueId v : graph.region(region).yields)
    if (is_root(v)) uses.at_element.push_back(v);
}

}  // namespace

Uses uses_of(const Graph& graph, const Op& op) {
  Uses uses;
  const auto is_constant = [&](ValueId v) { return graph.op(graph.value(v).op).kind == OpKind::Const; };
  switch (ops::info(op.kind).reads.value_or(ops::Reads::AtElement)) {
    case ops::Reads::AtElement: uses.at_element = op.operands; break;
    case ops::Reads::Elsewhere: uses.elsewhere = op.operands; break;
    case ops::Reads::FirstElsewhere:
      uses.elsewhere.push_back(op.operands[0]);
      uses.at_element.assign(op.operands.begin() + 1, op.operands.end());
      break;
    case ops::Reads::PerFace: std::ranges::remove_copy_if(op.operands, std::back_inserter(uses.elsewhere), is_constant);
  }
  for (ir::RegionId region : op.regions) add_region_uses(graph, region, uses);
  return uses;
}

std::vector<OpId> ops_of(const Graph& graph, std::span<const OpId> ops, std::span<const ValueId> values) {
  std::set<ValueId> needed(values.begin(), values.end());
  std::vector<OpId> out;
  for (size_t k = ops.size(); k-- > 0;) {
    const Op& op = graph.op(ops[k]);
    if (std::ranges::none_of(op.results, [&](ValueId v) { return needed.count(v) != 0; })) continue;
    out.push_back(ops[k]);
    const Uses uses = uses_of(graph, op);
    needed.insert(uses.at_element.begin(), uses.at_element.end());
    needed.insert(uses.elsewhere.begin(), uses.elsewhere.end());
  }
  std::ranges::reverse(out);
  return out;
}

std::vector<OpId> without(std::vector<OpId> ops, std::span<const OpId> others) {
  std::erase_if(ops, [&](OpId id) { return std::ranges::find(others, id) != others.end(); });
  return ops;
}

std::vector<OpId> in_order(const Graph& graph, const std::set<OpId>& ops) {
  std::vector<OpId> out;
  for (const OpId id : graph.region(graph.root()).ops)
    if (ops.contains(id)) out.push_back(id);
  return out;
}

std::vector<bool> steady_ops(const Graph& graph, const ir::Step& step, std::span<const OpId> order,
                             std::span<const Uses> uses, std::set<std::string> moving) {
  std::vector<bool> is_steady(graph.op_count(), false);
  for (const ir::Update& u : step.updates) moving.insert(graph.leaves[u.leaf].name);
  const auto steady = [&](ValueId v) { return is_steady[graph.value(v).op.index]; };
  for (OpId id : order) {
    const Op& op = graph.op(id);
    if (op.kind == OpKind::StepIndex || (op.kind == OpKind::Leaf && moving.count(op.attrs.text) != 0) ||
        std::ranges::any_of(uses[id.index].at_element, steady) || std::ranges::any_of(uses[id.index].elsewhere, steady))
      is_steady[id.index] = true;
  }
  return is_steady;
}

std::vector<bool> steady_ops(const Graph& graph, const ir::Step& step) {
  const std::vector<OpId>& order = graph.region(graph.root()).ops;
  std::vector<Uses> uses(graph.op_count());
  for (const OpId id : order) uses[id.index] = uses_of(graph, graph.op(id));
  return steady_ops(graph, step, order, uses);
}

}  // namespace dr::backend
