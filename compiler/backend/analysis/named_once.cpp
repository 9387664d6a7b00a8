// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/analysis/named_once.h"

#include <algorithm>
#include <optional>
#include <set>

#include "compiler/ir/yields.h"

namespace dr::backend {

using ir::Graph;
using ir::Op;
using ir::OpId;
using ir::OpKind;
using ir::RegionId;
using ir::ValueId;

namespace {

// An axis of the elements, by its number, or the trip parameter of a loop.
struct Variable {
  int axis = -1;
  ValueId trip;
  friend auto operator<=>(const Variable&, const Variable&) = default;
};

class Places {
 public:
  Places(const Graph& graph, const ir::Extent& domain, const std::set<ValueId>& trips)
      : graph_(graph), domain_(domain), trips_(trips) {}

  // Whether the components of an index tell all elements and trips apart.
  bool tells_apart(ValueId index, const ir::Extent& image) const {
    std::set<Variable> told;
    const int rows = graph_.value(index).type.rows;
    for (int c = 0; c < rows; ++c)
      if (const auto variable = variable_of(index, c)) told.insert(*variable);
    if (rows < 3 && image.l == domain_.l) told.insert({.axis = 2, .trip = {}});  // the element's own layer
    const ir::Dim* const axes[] = {&domain_.w, &domain_.h, &domain_.l};
    for (int axis = 0; axis < 3; ++axis)
      if (!axes[axis]->is_one() && !told.contains({.axis = axis, .trip = {}})) return false;
    return std::ranges::all_of(trips_, [&](ValueId trip) { return told.contains({.axis = -1, .trip = trip}); });
  }

 private:
  // The variable that a component of an integer is, but for a number that is added or taken away.
  std::optional<Variable> variable_of(ValueId v, int c) const {
    if (trips_.contains(v)) return Variable{.axis = -1, .trip = v};
    const OpId id = graph_.value(v).op;
    if (!id.valid()) return std::nullopt;
    const Op& op = graph_.op(id);
    if (op.kind == OpKind::Coord) {
      if (domain_of(op) != domain_) return std::nullopt;
      return Variable{.axis = static_cast<int>(op.attrs.ints[0]), .trip = {}};
    }
    if (op.kind == OpKind::Broadcast) return variable_of(op.operands[0], c);
    if (op.kind == OpKind::Splat) return variable_of(op.operands[0], 0);
    if (op.kind == OpKind::Compose) return variable_of(op.operands[static_cast<size_t>(c)], 0);
    if (op.kind == OpKind::Extract) return variable_of(op.operands[0], static_cast<int>(op.attrs.ints[0]));
    if (op.kind == OpKind::Add || op.kind == OpKind::Sub)
      for (const size_t k : {size_t{0}, size_t{1}})
        if (is_number(op.operands[1 - k])) return variable_of(op.operands[k], c);
    return std::nullopt;
  }

  // The same for all elements and trips.
  bool is_number(ValueId v) const {
    const OpId id = graph_.value(v).op;
    if (!id.valid()) return false;
    const OpKind kind = graph_.op(id).kind;
    return kind == OpKind::Const || kind == OpKind::DimValue;
  }

  static ir::Extent domain_of(const Op& coord) {
    return {coord.attrs.dims[0], coord.attrs.dims[1], coord.attrs.dims[2]};
  }

  const Graph& graph_;
  const ir::Extent& domain_;
  const std::set<ValueId>& trips_;
};

}  // namespace

bool named_once(const Graph& graph, ValueId result) {
  const OpId root = graph.value(result).op;
  if (!root.valid() || !ir::is_loop(graph.op(root).kind)) return false;
  const ir::Extent domain = ir::domain_of(graph.op(root));
  std::set<ValueId> trips;
  for (ValueId at = result;;) {
    const Op& op = graph.op(graph.value(at).op);
    if (!ir::is_loop(op.kind)) return false;
    const RegionId region = ir::yielding_regions(op)[0];
    trips.insert(graph.region(region).params[0]);
    const ir::Yielded yield = ir::yielded(graph, op, region)[graph.value(at).result_index];
    if (yield.index.valid()) return Places(graph, domain, trips).tells_apart(yield.index, graph.value(result).extent);
    at = yield.value;
  }
}

}  // namespace dr::backend
