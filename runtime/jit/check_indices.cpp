// SPDX-License-Identifier: Apache-2.0
#include "runtime/jit/check_indices.h"

#include <algorithm>

#include "compiler/backend/bundle/bundle.h"
#include "compiler/ir/initial_step.h"
#include "compiler/ir/parse.h"

namespace dr::jit {

namespace {

using ir::OpKind;

// The leaf and its component that an index is, unchanged: of all elements, or of the one at a constant place.
struct Column {
  std::string leaf;
  int64_t component = 0;
  std::optional<int64_t> element;
};

std::optional<Column> column_of(const ir::Graph& graph, ir::ValueId index) {
  const ir::Op* op = &graph.op(graph.value(index).op);
  Column out;
  if (op->kind == OpKind::Extract) {
    out.component = op->attrs.ints[0];
    op = &graph.op(graph.value(op->operands[0]).op);
  }
  if (op->kind == OpKind::Gather) {
    const ir::Op& place = graph.op(graph.value(op->operands[1]).op);
    if (place.kind != OpKind::Const || place.attrs.floats.size() != 1 || place.attrs.floats[0] < 0) return std::nullopt;
    out.element = static_cast<int64_t>(place.attrs.floats[0]);
    op = &graph.op(graph.value(op->operands[0]).op);
  }
  if (op->kind != OpKind::Leaf) return std::nullopt;
  out.leaf = op->attrs.text;
  return out;
}

// What a user calls an image that is indexed. Of one that a library made, with a point in its name, that is a leaf
// which has as many elements.
std::string name_of(const ir::Graph& graph, const ir::ValueInfo& from) {
  if (!from.name.empty() && from.name.find('.') == std::string::npos) return "'" + from.name + "'";
  const auto leaf = std::ranges::find(graph.leaves, from.extent.w, [](const ir::Leaf& l) { return l.extent.w; });
  const bool known = leaf != graph.leaves.end() && from.extent.w.as_symbol();
  return known ? "'" + leaf->name + "'" : "what it indexes";
}

// Which ops these steps need, and those that make leaves' first values.
std::vector<bool> ops_of(const ir::Graph& graph, std::span<const std::string> steps) {
  std::vector<ir::ValueId> roots;
  for (const ir::Step& step : graph.steps) {
    if (ir::leaf_of_initial_step(step.name).empty() && std::ranges::find(steps, step.name) == steps.end()) continue;
    for (const ir::Output& output : step.outputs) roots.push_back(output.value);
    for (const ir::Update& update : step.updates) roots.push_back(update.value);
  }
  return roots.empty() ? std::vector<bool>(graph.op_count()) : ir::live_ops(graph, roots);
}

}  // namespace

std::optional<std::string> check_indices(std::span<const uint8_t> bytes, std::span<const std::string> steps,
                                         const std::map<std::string, io::Array>& data,
                                         std::map<std::string, int64_t> given) {
  const auto bundle = bundle::read(bytes);
  if (std::holds_alternative<std::string>(bundle)) return std::nullopt;  // told by whoever runs it
  const auto parsed = ir::parse(std::get<bundle::BundleT>(bundle).graph);
  const auto* graph = std::get_if<ir::Graph>(&parsed);
  if (graph == nullptr) return std::nullopt;
  ir::SymbolValues symbols(given.begin(), given.end());
  for (const ir::Leaf& leaf : graph->leaves) {
    const auto bound = data.find(leaf.name);
    if (bound == data.end()) continue;
    const io::Array& a = bound->second;
    const std::pair<const ir::Dim*, int64_t> axes[] = {
        {&leaf.extent.w, a.width}, {&leaf.extent.h, a.height}, {&leaf.extent.l, a.layers}};
    for (const auto& [dim, size] : axes)
      if (const auto symbol = dim->as_symbol()) symbols.emplace(*symbol, size);
  }
  const std::vector<bool> needed = ops_of(*graph, steps);
  for (const ir::OpId id : graph->region(graph->root()).ops) {
    const ir::Op& op = graph->op(id);
    if (!needed[id.index] || op.kind != OpKind::Gather || graph->value(op.operands[1]).type.rows != 1) continue;
    const auto column = column_of(*graph, op.operands[1]);
    const ir::ValueInfo& from = graph->value(op.operands[0]);
    const auto count = from.extent.w.evaluate(symbols);
    const auto bound = column ? data.find(column->leaf) : data.end();
    if (bound == data.end() || !count || bound->second.bytes.empty()) continue;
    const io::Array& a = bound->second;
    const int64_t begin = column->element.value_or(0);
    const int64_t end = column->element ? std::min(begin + 1, a.size()) : a.size();
    for (int64_t k = begin; k < end; ++k) {
      const double named = a.scalar(k * a.components + column->component);
      if (named >= -1 && named < static_cast<double>(*count)) continue;
      return "leaf '" + column->leaf + "': element " + std::to_string(k) + " names " +
             std::to_string(static_cast<int64_t>(named)) + ", but " + name_of(*graph, from) + " has " +
             std::to_string(*count) + " elements";
    }
  }
  return std::nullopt;
}

}  // namespace dr::jit
