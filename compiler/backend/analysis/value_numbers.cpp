// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/analysis/value_numbers.h"

#include <algorithm>
#include <bit>
#include <ranges>

namespace dr::backend {

using ir::Op;
using ir::OpKind;
using ir::RegionId;
using ir::ValueId;

uint32_t ValueNumbers::of(ValueId value) {
  const auto it = numbers_.find(value);
  return it != numbers_.end() ? it->second : numbers_[value] = number_of("value " + std::to_string(value.index));
}

void ValueNumbers::add(const Op& op) {
  if (!op.results.empty() && numbers_.contains(op.results[0])) return;
  for (const RegionId region : op.regions)
    for (const ir::OpId inner : graph_.region(region).ops) add(graph_.op(inner));
  if (op.kind == OpKind::If) {
    for (size_t k = 0; k < op.results.size(); ++k) {
      const auto chosen = [&](size_t branch) { return of(graph_.region(op.regions[branch]).yields[k]); };
      numbers_[op.results[k]] = number_of("if " + std::to_string(of(op.operands[0])) + " " + std::to_string(chosen(0)) +
                                          " " + std::to_string(chosen(1)));
    }
    return;
  }
  if (!op.regions.empty()) return;
  std::string key = std::to_string(static_cast<int>(op.kind)) + " " + std::to_string(form_(op));
  for (const ValueId operand : op.operands) key += " " + std::to_string(of(operand));
  for (const int64_t number : op.attrs.ints) key += " i" + std::to_string(number);
  for (const double number : op.attrs.floats) key += " f" + std::to_string(std::bit_cast<uint64_t>(number));
  for (const ir::Dim& dim : op.attrs.dims) key += " d" + dim.str();
  key += " " + op.attrs.text;
  for (const ValueId result : op.results) {
    const ir::ValueInfo& info = graph_.value(result);
    numbers_[result] = number_of(key + " " + info.type.str() + " " + std::to_string(info.result_index));
  }
}

bool are_plain(const ir::Graph& graph, const std::vector<ir::OpId>& ops) {
  return std::ranges::all_of(ops, [&](ir::OpId id) {
    const Op& op = graph.op(id);
    if (op.kind == OpKind::ScatterAdd || op.kind == OpKind::ScatterMax) return false;
    if (op.regions.empty()) return true;
    return op.kind == OpKind::If &&
           std::ranges::all_of(op.attrs.yields, [](ir::Yield y) { return y == ir::Yield::Element; }) &&
           std::ranges::all_of(op.regions, [&](RegionId inner) { return are_plain(graph, graph.region(inner).ops); });
  });
}

namespace {

void collect(const ir::Graph& graph, RegionId region, std::set<ValueId>& needed) {
  for (const ir::OpId id : graph.region(region).ops | std::views::reverse) {
    const Op& op = graph.op(id);
    if (std::ranges::none_of(op.results, [&](ValueId v) { return needed.contains(v); })) continue;
    needed.insert(op.operands.begin(), op.operands.end());
    for (const RegionId inner : op.regions) {
      for (size_t k = 0; k < op.results.size(); ++k)
        if (needed.contains(op.results[k])) needed.insert(graph.region(inner).yields[k]);
      collect(graph, inner, needed);
    }
  }
}

}  // namespace

std::set<ValueId> needed_for(const ir::Graph& graph, RegionId region, const std::set<ValueId>& yields) {
  std::set<ValueId> needed = yields;
  collect(graph, region, needed);
  return needed;
}

}  // namespace dr::backend
