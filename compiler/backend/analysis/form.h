// SPDX-License-Identifier: Apache-2.0
// Whether values of a graph have a form, asked op by op.
#pragma once

#include "compiler/ir/graph.h"

namespace dr::backend {

class Form {
 public:
  explicit Form(const ir::Graph& graph) : graph_(graph) {}

  const ir::Op* made_by(ir::ValueId v, ir::OpKind kind) const {
    const ir::OpId id = graph_.value(v).op;
    return id.valid() && graph_.op(id).kind == kind ? &graph_.op(id) : nullptr;
  }
  bool is_number(ir::ValueId v, double number) const {
    const ir::Op* op = made_by(v, ir::OpKind::Const);
    return op != nullptr && op->attrs.floats.size() == 1 && op->attrs.floats[0] == number;
  }
  bool is_extent(ir::ValueId v, const ir::Dim& dim) const {
    if (dim.is_constant()) return is_number(v, static_cast<double>(dim.constant()));
    const ir::Op* op = made_by(v, ir::OpKind::DimValue);
    return op != nullptr && op->attrs.dims[0] == dim;
  }
  bool is_place(ir::ValueId v, int axis) const {
    const ir::Op* op = made_by(v, ir::OpKind::Coord);
    return op != nullptr && op->attrs.ints[0] == axis;
  }
  // The number of a run of 2^bits elements in a row, or of more: a place in it without its last bits.
  bool is_number_of_run(const ir::Op& op, int bits) const {
    if (op.kind != ir::OpKind::ShiftRight || !is_place(op.operands[0], 0)) return false;
    const ir::Op* by = made_by(op.operands[1], ir::OpKind::Const);
    return by != nullptr && by->attrs.floats.size() == 1 && by->attrs.floats[0] >= bits && by->attrs.floats[0] < 32;
  }
  // Whether it is `kind` of what `first` and `second` hold for, in either order.
  template <class First, class Second>
  bool is_both(ir::ValueId v, ir::OpKind kind, const First& first, const Second& second) const {
    const ir::Op* op = made_by(v, kind);
    if (op == nullptr || op->operands.size() != 2) return false;
    const ir::ValueId a = op->operands[0], b = op->operands[1];
    return (first(a) && second(b)) || (first(b) && second(a));
  }

 private:
  const ir::Graph& graph_;
};

}  // namespace dr::backend
