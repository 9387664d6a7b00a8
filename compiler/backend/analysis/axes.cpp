// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/analysis/axes.h"

#include <algorithm>

#include "compiler/ir/yields.h"

namespace dr::backend {

using ir::Op;
using ir::OpId;
using ir::OpKind;
using ir::ValueId;

namespace {

constexpr Axes kLayers = 4;

}  // namespace

Axes axes_of(const ir::Extent& extent) {
  return static_cast<Axes>((extent.w.is_one() ? 0 : 1) | (extent.h.is_one() ? 0 : 2) | (extent.l.is_one() ? 0 : 4));
}

// In order, so that what a value is made of is known before it.
ChangingAxes::ChangingAxes(const ir::Graph& graph) : graph_(&graph), known_(graph.value_count()) { look(graph.root()); }

void ChangingAxes::look(ir::RegionId region) {
  for (const OpId id : graph_->region(region).ops) {
    for (const ir::RegionId inner : graph_->op(id).regions) look(inner);
    of(graph_->op(id));
  }
}

Axes ChangingAxes::of(ValueId value) {
  uint8_t& known = known_[value.index];
  if (known == 0) {
    const Axes found = find(value);
    known_[value.index] = static_cast<uint8_t>(found + 1);
  }
  return static_cast<Axes>(known_[value.index] - 1);
}

Axes ChangingAxes::of(const Op& op) {
  Axes all = 0;
  for (const ValueId v : op.results) all |= of(v);
  return all;
}

Axes ChangingAxes::find(ValueId value) {
  const ir::ValueInfo& info = graph_->value(value);
  if (!info.op.valid()) {
    const OpId parent = graph_->region(info.region).parent;
    if (!parent.valid()) return axes_of(info.extent);
    const Op& loop = graph_->op(parent);
    // A trip's number is one of those between the bounds, in their order.
    if (loop.kind == OpKind::Reduce) return static_cast<Axes>(of(loop.operands[0]) | of(loop.operands[1]));
    return 7;
  }
  const Op& op = graph_->op(info.op);
  Axes axes = 0;
  const auto operands = [&] {
    for (const ValueId v : op.operands) axes |= of(v);
    return axes;
  };
  switch (op.kind) {
    case OpKind::Const:
    case OpKind::DimValue:
    case OpKind::StepIndex: return 0;
    case OpKind::Coord:
      return op.attrs.dims[static_cast<size_t>(op.attrs.ints[0])].is_one() ? Axes{0}
                                                                           : static_cast<Axes>(1 << op.attrs.ints[0]);
    case OpKind::Gather: {
      // An index of fewer components names a place in the element's own layer.
      const bool own_layer = graph_->value(op.operands[1]).type.rows < 3;
      const bool has_layers = !graph_->value(op.operands[0]).extent.l.is_one();
      return static_cast<Axes>(of(op.operands[1]) | (own_layer && has_layers ? kLayers : 0));
    }
    case OpKind::If: return static_cast<Axes>(operands() | of_regions(op));
    case OpKind::Reduce: {
      operands();
      const ir::Yielded part = ir::yielded(*graph_, op, op.regions[0])[info.result_index];
      if (part.index.valid() || graph_->value(part.value).accumulation) return 7;
      return static_cast<Axes>(axes | of(part.value));
    }
    case OpKind::Leaf:
    case OpKind::Shift:
    case OpKind::ReduceSum:
    case OpKind::ReduceMin:
    case OpKind::ReduceMax:
    case OpKind::Fold:
    case OpKind::Raster:
    case OpKind::ScatterAdd:
    case OpKind::ScatterMax:
    case OpKind::Vjp:
    case OpKind::Cotangent:
    case OpKind::Grad: return op.parent == graph_->root() ? axes_of(info.extent) : Axes{7};
    case OpKind::Broadcast:
    case OpKind::Pin:
    case OpKind::Detach:
#define DR_OP(kind, name)
#define DR_ELEMENTWISE(kind, name) case OpKind::kind:
#include "compiler/ir/op_kinds.def"
#undef DR_OP
      return operands();
  }
  return 7;
}

Axes ChangingAxes::of_regions(const Op& op) {
  Axes axes = 0;
  for (const ir::RegionId region : op.regions) {
    for (const ValueId v : graph_->region(region).yields) axes |= graph_->value(v).accumulation ? Axes{7} : of(v);
  }
  return axes;
}

bool shares_trips(const Op& op, Axes axes, ChangingAxes& changing) {
  if (op.kind != OpKind::Reduce) return false;
  if (((changing.of(op.operands[0]) | changing.of(op.operands[1])) & axes) != 0) return false;
  return std::ranges::none_of(op.attrs.yields, [](ir::Yield y) { return y == ir::Yield::Scatter; });
}

}  // namespace dr::backend
