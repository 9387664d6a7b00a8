// SPDX-License-Identifier: Apache-2.0
#include "tests/device/accuracy/batch.h"

#include <algorithm>

namespace dr::accuracy {

using ir::OpKind;
using ir::ValueId;

BatchGraph::BatchGraph(const ir::Graph& graph) {
  std::vector<ValueId> roots;
  for (const ir::Step& step : graph.steps)
    for (const ir::Output& o : step.outputs) roots.push_back(o.value);
  const std::vector<bool> live = ir::live_ops(graph, roots);
  std::vector<double*> plane_of(graph.value_count(), nullptr);
  const auto new_plane = [&](ValueId value) {
    DR_ASSERT(graph.value(value).type.is_scalar());
    planes_.push_back(std::make_unique<double[]>(kBatch));
    return plane_of[value.index] = planes_.back().get();
  };
  for (const ir::OpId id : graph.region(graph.root()).ops) {
    if (!live[id.index]) continue;
    const ir::Op& op = graph.op(id);
    switch (op.kind) {
      case OpKind::Leaf: leaves_.emplace_back(op.attrs.text, new_plane(op.results[0])); continue;
      case OpKind::Const: std::fill_n(new_plane(op.results[0]), kBatch, op.attrs.floats[0]); continue;
      case OpKind::Broadcast:
      case OpKind::Detach: plane_of[op.results[0].index] = plane_of[op.operands[0].index]; continue;
      default: break;
    }
    const ops::OpInfo& info = ops::info(op.kind);
    DR_ASSERT(info.shape == ops::Shape::Elementwise);
    Op mine{.info = &info,
            .operands = {},
            .types = {},
            .attrs = &op.attrs,
            .type = graph.value(op.results[0]).type,
            .result = nullptr};
    for (const ValueId v : op.operands) {
      mine.operands.push_back(plane_of[v.index]);
      mine.types.push_back(graph.value(v).type);
    }
    mine.result = new_plane(op.results[0]);
    ops_.push_back(std::move(mine));
  }
  for (const ir::Step& step : graph.steps)
    for (const ir::Output& o : step.outputs) outputs_.emplace_back(o.name, plane_of[o.value.index]);
}

size_t BatchGraph::output(const std::string& name) const {
  const auto found = std::ranges::find(outputs_, name, [](const auto& o) { return o.first; });
  return found == outputs_.end() ? kNone : static_cast<size_t>(found - outputs_.begin());
}

double* BatchGraph::leaf(const std::string& name) {
  const auto found = std::ranges::find(leaves_, name, [](const auto& l) { return l.first; });
  return found == leaves_.end() ? nullptr : found->second;
}

void BatchGraph::run(size_t n) {
  for (const Op& op : ops_)
    op.info->eval({.n = n,
                   .operands = op.operands,
                   .operand_types = op.types,
                   .attrs = *op.attrs,
                   .result_type = op.type,
                   .result = op.result});
}

}  // namespace dr::accuracy
