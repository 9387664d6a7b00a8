// SPDX-License-Identifier: Apache-2.0
// Building and copying graphs, and the two analyses that every pass wants: what a region captures, what is live.
#include "compiler/ir/graph.h"

#include <algorithm>
#include <array>
#include <unordered_map>

#include "compiler/ir/internal_error.h"

namespace dr::ir {
namespace {

constexpr auto kOpNames = std::to_array<std::string_view>({
#define DR_OP(name, text) text,
#include "compiler/ir/op_kinds.def"
#undef DR_OP
});

// The region and all regions inside it, sorted.
void collect_regions(const Graph& graph, RegionId region, std::vector<RegionId>& out) {
  out.push_back(region);
  for (OpId op : graph.region(region).ops) {
    for (RegionId inner : graph.op(op).regions) collect_regions(graph, inner, out);
  }
}

void collect_uses(const Graph& graph, RegionId region, const std::vector<RegionId>& inside, std::vector<ValueId>& out) {
  const auto use = [&](ValueId id) {
    if (!std::binary_search(inside.begin(), inside.end(), graph.value(id).region)) out.push_back(id);
  };
  for (OpId id : graph.region(region).ops) {
    const Op& op = graph.op(id);
    for (ValueId operand : op.operands) use(operand);
    for (RegionId inner : op.regions) collect_uses(graph, inner, inside, out);
  }
  for (ValueId yield : graph.region(region).yields) use(yield);
}

}  // namespace

std::string_view op_name(OpKind kind) { return kOpNames[static_cast<size_t>(kind)]; }

std::optional<OpKind> op_kind(std::string_view name) {
  static const auto kinds = [] {
    std::unordered_map<std::string_view, OpKind> map;
    for (OpKind kind : all_op_kinds()) map.emplace(op_name(kind), kind);
    return map;
  }();
  const auto found = kinds.find(name);
  if (found == kinds.end()) return std::nullopt;
  return found->second;
}

std::vector<OpKind> all_op_kinds() {
  std::vector<OpKind> kinds;
  for (size_t i = 0; i < kOpNames.size(); ++i) kinds.push_back(static_cast<OpKind>(i));
  return kinds;
}

std::optional<uint32_t> Graph::leaf_index(std::string_view name) const {
  for (uint32_t i = 0; i < leaves.size(); ++i) {
    if (leaves[i].name == name) return i;
  }
  return std::nullopt;
}

std::optional<uint32_t> Graph::step_index(std::string_view name) const {
  for (uint32_t i = 0; i < steps.size(); ++i) {
    if (steps[i].name == name) return i;
  }
  return std::nullopt;
}

OpId Builder::add(OpKind kind, std::vector<ValueId> operands, std::span<const ResultType> results, Attrs attrs,
                  std::vector<RegionId> regions, dsl::Span span) {
  for (ValueId operand : operands) DR_ASSERT(operand.index < graph_.values_.size());
  const OpId id{static_cast<uint32_t>(graph_.ops_.size())};
  const RegionId parent = current_region();
  for (RegionId region : regions) {
    DR_ASSERT(region.index < graph_.regions_.size() && !graph_.regions_[region.index].parent.valid());
    graph_.regions_[region.index].parent = id;
  }
  // Filled in place: graphs have many ops, and an op is large to move.
  Op& op = graph_.ops_.emplace_back();
  op.kind = kind;
  op.operands = std::move(operands);
  op.regions = std::move(regions);
  op.attrs = std::move(attrs);
  op.span = span.valid() ? span : span_;
  op.parent = parent;
  op.results.reserve(results.size());
  for (const ResultType& result : results) {
    op.results.push_back(ValueId{static_cast<uint32_t>(graph_.values_.size())});
    ValueInfo& value = graph_.values_.emplace_back();
    value.type = result.type;
    value.extent = result.extent;
    value.op = id;
    value.region = parent;
    value.result_index = static_cast<uint32_t>(op.results.size() - 1);
    value.accumulation = result.accumulation;
  }
  graph_.regions_[parent.index].ops.push_back(id);
  return id;
}

void Builder::reserve(size_t ops) {
  graph_.ops_.reserve(ops);
  graph_.values_.reserve(ops);
}

RegionId Builder::begin_region(std::span<const ResultType> params) {
  const RegionId id{static_cast<uint32_t>(graph_.regions_.size())};
  Region& region = graph_.regions_.emplace_back();
  for (const ResultType& param : params) {
    region.params.push_back(ValueId{static_cast<uint32_t>(graph_.values_.size())});
    graph_.values_.push_back({param.type,
                              param.extent,
                              OpId{},
                              id,
                              static_cast<uint32_t>(region.params.size() - 1),
                              param.accumulation,
                              {}});
  }
  stack_.push_back(id);
  return id;
}

void Builder::end_region(std::vector<ValueId> yields) {
  DR_ASSERT(stack_.size() > 1);
  for (ValueId yield : yields) DR_ASSERT(yield.index < graph_.values_.size());
  graph_.regions_[current_region().index].yields = std::move(yields);
  stack_.pop_back();
}

namespace {

ValueId mapped(const Graph& from, ValueId id, const ValueMap& map) {
  if (!map.has(id)) {
    const ValueInfo& info = from.value(id);
    DR_ICE("copy of a value that has no counterpart: %" + (info.name.empty() ? "" : info.name + ".") +
           std::to_string(id.index) +
           (info.op.valid() ? " of op " + std::string(op_name(from.op(info.op).kind)) : " (a region parameter)"));
  }
  return map[id];
}

std::vector<ValueId> mapped(const Graph& from, const std::vector<ValueId>& ids, const ValueMap& map) {
  std::vector<ValueId> out;
  out.reserve(ids.size());
  for (ValueId id : ids) out.push_back(mapped(from, id, map));
  return out;
}

ResultType result_type(const ValueInfo& info) { return {info.type, info.extent, info.accumulation}; }

void enter(const Graph& from, ValueId old, Builder& to, ValueId now, ValueMap& map) {
  map.set(old, now);
  if (!from.value(old).name.empty()) to.set_name(now, from.value(old).name);
}

}  // namespace

void copy_op(const Graph& from, OpId id, Builder& to, ValueMap& map) {
  const Op& op = from.op(id);
  std::vector<RegionId> regions;
  for (RegionId old : op.regions) {
    const Region& region = from.region(old);
    std::vector<ResultType> params;
    for (ValueId param : region.params) params.push_back(result_type(from.value(param)));
    const RegionId now = to.begin_region(params);
    for (size_t i = 0; i < params.size(); ++i) enter(from, region.params[i], to, to.graph().region(now).params[i], map);
    for (OpId inner : region.ops) copy_op(from, inner, to, map);
    to.end_region(mapped(from, region.yields, map));
    regions.push_back(now);
  }
  std::vector<ResultType> results;
  for (ValueId result : op.results) {
    ResultType type = result_type(from.value(result));
    // Scatter results are accumulations inside a region and images in the root; a copy may move between them.
    const size_t k = from.value(result).result_index;
    if (k < op.attrs.yields.size() && op.attrs.yields[k] == Yield::Scatter)
      type.accumulation = to.current_region() != to.graph().root();
    results.push_back(type);
  }
  const OpId now = to.add(op.kind, mapped(from, op.operands, map), results, op.attrs, std::move(regions), op.span);
  for (size_t i = 0; i < op.results.size(); ++i) enter(from, op.results[i], to, to.graph().op(now).results[i], map);
}

std::vector<ValueId> captures(const Graph& graph, RegionId region) {
  std::vector<RegionId> inside;
  collect_regions(graph, region, inside);
  std::sort(inside.begin(), inside.end());
  std::vector<ValueId> uses;
  collect_uses(graph, region, inside, uses);
  std::sort(uses.begin(), uses.end());
  uses.erase(std::unique(uses.begin(), uses.end()), uses.end());
  return uses;
}

std::vector<ValueId> needs_of(const Graph& graph, const Op& op) {
  std::vector<ValueId> out = op.operands;
  for (const RegionId region : op.regions) {
    const std::vector<ValueId> more = captures(graph, region);
    out.insert(out.end(), more.begin(), more.end());
  }
  return out;
}

std::vector<bool> live_ops(const Graph& graph, std::span<const ValueId> roots) {
  std::vector<bool> live(graph.op_count());
  std::vector<bool> wanted(graph.value_count());
  if (roots.empty()) {
    for (const Step& step : graph.steps) {
      for (const Output& output : step.outputs) wanted[output.value.index] = true;
      for (const Update& update : step.updates) wanted[update.value.index] = true;
    }
  }
  for (ValueId root : roots) wanted[root.index] = true;

  // Operands come before users, so one walk backwards sees every use of a value before the op that makes it.
  const auto& ops = graph.region(graph.root()).ops;
  for (auto it = ops.rbegin(); it != ops.rend(); ++it) {
    const Op& op = graph.op(*it);
    if (std::none_of(op.results.begin(), op.results.end(), [&](ValueId result) { return wanted[result.index]; }))
      continue;
    live[it->index] = true;
    for (ValueId operand : op.operands) wanted[operand.index] = true;
    for (RegionId region : op.regions) {
      for (ValueId captured : captures(graph, region)) wanted[captured.index] = true;
    }
  }
  return live;
}

void internal_error(const char* file, int line, const std::string& message) {
  throw InternalError(std::string(file) + ":" + std::to_string(line) + ": " + message);
}

}  // namespace dr::ir
