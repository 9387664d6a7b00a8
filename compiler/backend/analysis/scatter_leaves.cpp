// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/analysis/scatter_leaves.h"

#include <algorithm>
#include <set>

#include "compiler/backend/analysis/uses.h"
#include "compiler/ir/yields.h"

namespace dr::backend {

using ir::Graph;
using ir::Op;
using ir::OpId;
using ir::OpKind;
using ir::RegionId;
using ir::ValueId;

namespace {

bool is_never_in_range(const Graph& graph, ValueId index) {
  const ir::OpId id = graph.value(index).op;
  return id.valid() && graph.op(id).kind == OpKind::Const &&
         std::ranges::any_of(graph.op(id).attrs.floats, [](double x) { return x < 0; });
}

// False where a loop makes contributions.
bool collect(const Graph& graph, ValueId result, std::vector<ScatterLeaf::Branch>& path,
             std::vector<ScatterLeaf>& leaves) {
  const OpId id = graph.value(result).op;
  const Op& op = graph.op(id);
  if (op.kind == OpKind::ScatterAdd) {
    leaves.push_back({path, op.operands[0], op.operands[1]});
    return true;
  }
  if (op.kind != OpKind::If) return false;
  for (size_t region = 0; region < 2; ++region) {
    const ir::Yielded part = ir::yielded(graph, op, op.regions[region])[graph.value(result).result_index];
    path.push_back({.op = id, .region = region});
    if (!part.index.valid()) {
      if (!collect(graph, part.value, path, leaves)) return false;
    } else if (!is_never_in_range(graph, part.index)) {
      leaves.push_back({path, part.index, part.value});
    }
    path.pop_back();
  }
  return true;
}

// Walks from values back, region by region outwards; those that it has reached in the end are of the root region.
std::set<ValueId> walk(const Graph& graph, const ScatterLeaf& leaf, std::span<const OpId> root_ops,
                       std::span<const ValueId> values, std::vector<OpId>& ops) {
  std::set<ValueId> needed(values.begin(), values.end());
  const auto visit = [&](std::span<const OpId> region, bool root) {
    for (size_t k = region.size(); k-- > 0;) {
      const Op& op = graph.op(region[k]);
      if (std::ranges::none_of(op.results, [&](ValueId v) { return needed.count(v) != 0; })) continue;
      ops.push_back(region[k]);
      if (root) {
        const Uses uses = uses_of(graph, op);
        needed.insert(uses.at_element.begin(), uses.at_element.end());
        continue;
      }
      needed.insert(op.operands.begin(), op.operands.end());
      for (const RegionId inner : op.regions)
        for (const ValueId v : ir::captures(graph, inner)) needed.insert(v);
    }
  };
  for (size_t k = leaf.path.size(); k-- > 0;) {
    const ScatterLeaf::Branch& branch = leaf.path[k];
    visit(graph.region(graph.op(branch.op).regions[branch.region]).ops, false);
  }
  visit(root_ops, true);
  std::ranges::reverse(ops);
  std::erase_if(needed, [&](ValueId v) { return graph.value(v).region != graph.root(); });
  return needed;
}

}  // namespace

std::optional<std::vector<ScatterLeaf>> scatter_leaves(const Graph& graph, ValueId result) {
  std::vector<ScatterLeaf> leaves;
  std::vector<ScatterLeaf::Branch> path;
  if (!collect(graph, result, path, leaves)) return std::nullopt;
  return leaves;
}

int contributions(const Graph& graph, ValueId result) {
  const Op& op = graph.op(graph.value(result).op);
  if (op.regions.empty()) return 1;
  if (ir::is_loop(op.kind)) return -1;
  int most = 0;
  for (const RegionId region : op.regions) {
    const ir::Yielded yield = ir::yielded(graph, op, region)[graph.value(result).result_index];
    const int here = yield.index.valid() ? 1 : contributions(graph, yield.value);
    if (here < 0) return -1;
    most = std::max(most, here);
  }
  return most;
}

std::vector<OpId> ops_at(const Graph& graph, const ScatterLeaf& leaf, std::span<const OpId> root_ops,
                         std::span<const ValueId> values) {
  std::vector<OpId> ops;
  walk(graph, leaf, root_ops, values, ops);
  return ops;
}

std::vector<ValueId> root_values_at(const Graph& graph, const ScatterLeaf& leaf, std::span<const ValueId> values) {
  std::vector<OpId> ops;
  const std::set<ValueId> reached = walk(graph, leaf, {}, values, ops);
  return {reached.begin(), reached.end()};
}

}  // namespace dr::backend
