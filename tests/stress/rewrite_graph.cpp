// SPDX-License-Identifier: Apache-2.0
#include "tests/stress/rewrite_graph.h"

#include <algorithm>
#include <stdexcept>

#include "compiler/ir/internal_error.h"
#include "compiler/ops/emit.h"
#include "compiler/passes/passes.h"

namespace dr::test {

using namespace ir;

namespace {

// An op with inferred types; a constant has its own.
std::vector<ValueId> emitted(Builder& to, const Graph& from, const Op& op, std::vector<ValueId> operands, Attrs attrs,
                             std::vector<RegionId> regions) {
  if (op.kind == OpKind::Const) return {ops::constant(to, from.value(op.results[0]).type, std::move(attrs.floats))};
  if (op.kind == OpKind::Broadcast)
    return {ops::broadcast(to, operands.at(0), {attrs.dims.at(0), attrs.dims.at(1), attrs.dims.at(2)})};
  return ops::emit_multi(to, op.kind, std::move(operands), std::move(attrs), std::move(regions));
}

bool is_region_op(OpKind kind) { return kind == OpKind::If || kind == OpKind::Reduce || kind == OpKind::Fold; }

// Where the yields of result k begin in a region, and how many there are.
std::pair<size_t, size_t> yields_of(const Graph& graph, const Op& op, RegionId region, size_t k) {
  const std::vector<ValueId>& yields = graph.region(region).yields;
  size_t at = op.kind == OpKind::Fold && op.attrs.ints[1] != 0 ? 1 : 0;
  const auto count = [&](size_t result) -> size_t {
    return op.attrs.yields[result] == Yield::Scatter && !graph.value(yields.at(at)).accumulation ? 2 : 1;
  };
  for (size_t result = 0; result < k; ++result) at += count(result);
  return {at, count(k)};
}

// Where the extent of Scatter result k begins in the attributes.
size_t scatter_dims(const Op& op, size_t k) {
  const auto scatters =
      std::count(op.attrs.yields.begin(), op.attrs.yields.begin() + static_cast<ptrdiff_t>(k), Yield::Scatter);
  return 3 + 3 * static_cast<size_t>(scatters);
}

class Rewriter {
 public:
  Rewriter(const Graph& from, const Edit& edit) : from_(from), edit_(edit), map_(from.value_count()) {}

  Graph run() && {
    Graph& graph = to_.graph();
    graph.leaves = from_.leaves;
    for (Leaf& leaf : graph.leaves) leaf.extent = of(leaf.extent);
    copy_ops(from_.root());
    size_t number = 0;
    for (const Step& step : from_.steps) {
      Step now{step.name, {}, {}};
      for (const Output& output : step.outputs) {
        const auto other = edit_.outputs.find(number);
        const ValueId value = other != edit_.outputs.end() ? other->second : output.value;
        if (!edit_.without_outputs.contains(number++)) now.outputs.push_back({output.name, at(value)});
      }
      for (const Update& update : step.updates) now.updates.push_back({update.leaf, at(update.value)});
      graph.steps.push_back(std::move(now));
    }
    return std::move(to_).finish();
  }

 private:
  Dim of(const Dim& dim) const {
    return edit_.extent != 0 && dim.is_constant() && dim.constant() == edit_.extent ? Dim(edit_.shrunk) : dim;
  }
  Extent of(const Extent& e) const { return {of(e.w), of(e.h), of(e.l)}; }
  bool at_root() const { return to_.current_region() == to_.graph().root(); }

  ValueId at(ValueId old) const {
    if (!map_.has(old)) DR_ICE("a value that is gone");
    return map_[old];
  }
  std::vector<ValueId> at(const std::vector<ValueId>& old) const {
    std::vector<ValueId> now;
    for (const ValueId id : old) now.push_back(at(id));
    return now;
  }
  // Images keep their extent; in a region values stretch by themselves.
  void set(ValueId old, ValueId now) {
    if (at_root()) now = ops::broadcast(to_, now, of(from_.value(old).extent));
    map_.set(old, now);
  }
  void set_unless_edited(ValueId old, ValueId now) {
    map_.set(old, now);
    const auto found = edit_.values.find(old);
    if (found == edit_.values.end() || from_.value(old).accumulation) return;
    const Instead& instead = found->second;
    set(old, instead.value ? at(*instead.value) : ops::constant(to_, from_.value(old).type, instead.constant));
  }

  void copy_ops(RegionId region) {
    for (const OpId op : from_.region(region).ops) copy(op);
  }

  void copy(OpId id) {
    if (id == edit_.inlined) return copy_inlined(from_.op(id));
    const Op& op = from_.op(id);
    const bool narrowed = id == edit_.narrowed;
    Attrs attrs = op.attrs;
    for (Dim& dim : attrs.dims) dim = of(dim);
    if (id == edit_.constant) attrs.floats.assign(attrs.floats.size(), edit_.becomes);
    if (narrowed) narrow(op, attrs);
    std::vector<RegionId> regions;
    for (const RegionId region : op.regions) regions.push_back(copy_region(op, region, narrowed));
    const std::vector<ValueId> results = emitted(to_, from_, op, at(op.operands), std::move(attrs), std::move(regions));
    for (size_t k = 0, next = 0; k < op.results.size(); ++k) {
      if (narrowed && k == edit_.result) continue;
      set_unless_edited(op.results[k], results.at(next++));
    }
  }

  void narrow(const Op& op, Attrs& attrs) const {
    if (attrs.yields.at(edit_.result) == Yield::Scatter) {
      const auto first = attrs.dims.begin() + static_cast<ptrdiff_t>(scatter_dims(op, edit_.result));
      attrs.dims.erase(first, first + 3);
    }
    attrs.yields.erase(attrs.yields.begin() + static_cast<ptrdiff_t>(edit_.result));
  }

  RegionId copy_region(const Op& op, RegionId region, bool narrowed) {
    std::vector<ResultType> types;
    const std::vector<ValueId>& params = from_.region(region).params;
    for (const ValueId param : params) types.push_back({from_.value(param).type, of(from_.value(param).extent)});
    const RegionId now = to_.begin_region(types);
    const std::vector<ValueId> given = to_.graph().region(now).params;
    for (size_t k = 0; k < params.size(); ++k) set_unless_edited(params[k], given[k]);
    copy_ops(region);
    std::vector<ValueId> yields = from_.region(region).yields;
    if (narrowed) {
      const auto [first, count] = yields_of(from_, op, region, edit_.result);
      const auto begin = yields.begin() + static_cast<ptrdiff_t>(first);
      yields.erase(begin, begin + static_cast<ptrdiff_t>(count));
    }
    to_.end_region(yielded(yields));
    return now;
  }

  std::vector<ValueId> yielded(const std::vector<ValueId>& yields) {
    std::vector<ValueId> now;
    for (const ValueId yield : yields) {
      const auto edited = edit_.values.find(yield);
      if (edited == edit_.values.end() || !from_.value(yield).accumulation) {
        now.push_back(at(yield));
        continue;
      }
      now.push_back(ops::constant(to_, vec(3, Scalar::Int), 0.0));
      now.push_back(ops::constant(to_, from_.value(yield).type, edited->second.constant));
    }
    return now;
  }

  void copy_inlined(const Op& op) {
    const RegionId region = op.regions.at(edit_.region);
    const std::vector<ValueId>& params = from_.region(region).params;
    if (op.regions.size() > 1 && op.kind != OpKind::If) DR_ICE("a loop of several sweeps");
    for (size_t k = 0; k < params.size(); ++k) map_.set(params[k], at(op.operands.at(k == 0 ? 0 : k + 1)));
    copy_ops(region);
    for (size_t k = 0; k < op.results.size(); ++k) {
      const auto [first, count] = yields_of(from_, op, region, k);
      const std::vector<ValueId>& yields = from_.region(region).yields;
      if (op.attrs.yields[k] == Yield::Scatter) {
        if (count != 2 || !at_root()) DR_ICE("what a region scatters stays in one");
        Attrs attrs;
        const size_t dims = scatter_dims(op, k);
        for (size_t axis = 0; axis < 3; ++axis) attrs.dims.push_back(of(op.attrs.dims.at(dims + axis)));
        const Extent domain = of(Extent{op.attrs.dims[0], op.attrs.dims[1], op.attrs.dims[2]});
        const ValueId index = ops::broadcast(to_, at(yields[first]), domain);
        set(op.results[k], ops::emit(to_, OpKind::ScatterAdd, {index, at(yields[first + 1])}, std::move(attrs)));
      } else {
        const bool counts = op.attrs.yields[k] == Yield::ArgMin;
        set(op.results[k], at(counts ? op.operands[0] : yields[first]));
      }
    }
  }

  const Graph& from_;
  const Edit& edit_;
  Builder to_;
  ValueMap map_;
};

// Marks what the values marked so far need, last op first.
void mark(const Graph& graph, RegionId region, std::vector<bool>& wanted, std::vector<bool>& live) {
  const std::vector<OpId>& ops = graph.region(region).ops;
  for (auto it = ops.rbegin(); it != ops.rend(); ++it) {
    const Op& op = graph.op(*it);
    if (std::ranges::none_of(op.results, [&](ValueId result) { return wanted[result.index]; })) continue;
    live[it->index] = true;
    for (const ValueId operand : op.operands) wanted[operand.index] = true;
    for (const RegionId inner : op.regions) {
      for (const ValueId yield : graph.region(inner).yields) wanted[yield.index] = true;
      mark(graph, inner, wanted, live);
    }
  }
}

void copy_live(const Graph& from, RegionId region, const std::vector<bool>& live, Builder& to, ValueMap& map) {
  for (const OpId id : from.region(region).ops) {
    if (!live[id.index]) continue;
    const Op& op = from.op(id);
    std::vector<RegionId> regions;
    for (const RegionId inner : op.regions) {
      std::vector<ResultType> types;
      for (const ValueId param : from.region(inner).params)
        types.push_back({from.value(param).type, from.value(param).extent});
      const RegionId now = to.begin_region(types);
      for (size_t k = 0; k < types.size(); ++k) map.set(from.region(inner).params[k], to.graph().region(now).params[k]);
      copy_live(from, inner, live, to, map);
      std::vector<ValueId> yields;
      for (const ValueId yield : from.region(inner).yields) yields.push_back(map[yield]);
      to.end_region(std::move(yields));
      regions.push_back(now);
    }
    std::vector<ValueId> operands;
    for (const ValueId operand : op.operands) operands.push_back(map[operand]);
    const auto results = emitted(to, from, op, std::move(operands), op.attrs, std::move(regions));
    for (size_t k = 0; k < results.size(); ++k) map.set(op.results[k], results[k]);
  }
}

Graph without_dead(const Graph& from) {
  std::vector<bool> wanted(from.value_count()), live(from.op_count());
  std::set<uint32_t> written;
  for (const Step& step : from.steps) {
    for (const Output& output : step.outputs) wanted[output.value.index] = true;
    for (const Update& update : step.updates) {
      wanted[update.value.index] = true;
      written.insert(update.leaf);
    }
  }
  mark(from, from.root(), wanted, live);
  Builder to;
  std::set<std::string> read;
  for (const OpId id : from.region(from.root()).ops)
    if (live[id.index] && from.op(id).kind == OpKind::Leaf) read.insert(from.op(id).attrs.text);
  std::map<uint32_t, uint32_t> place;
  for (uint32_t k = 0; k < from.leaves.size(); ++k) {
    if (!written.contains(k) && !read.contains(from.leaves[k].name)) continue;
    place[k] = static_cast<uint32_t>(to.graph().leaves.size());
    to.graph().leaves.push_back(from.leaves[k]);
  }
  ValueMap map(from.value_count());
  copy_live(from, from.root(), live, to, map);
  for (const Step& step : from.steps) {
    Step now{step.name, {}, {}};
    for (const Output& output : step.outputs) now.outputs.push_back({output.name, map[output.value]});
    for (const Update& update : step.updates) now.updates.push_back({place.at(update.leaf), map[update.value]});
    to.graph().steps.push_back(std::move(now));
  }
  return std::move(to).finish();
}

void collect(const Graph& graph, RegionId region, std::vector<OpId>& out) {
  for (const OpId op : graph.region(region).ops) {
    for (const RegionId inner : graph.op(op).regions) collect(graph, inner, out);
    out.push_back(op);
  }
}

}  // namespace

std::vector<OpId> all_ops(const Graph& graph) {
  std::vector<OpId> out;
  collect(graph, graph.root(), out);
  return out;
}

std::optional<Graph> rewritten(const Graph& graph, const Edit& edit) {
  if (edit.inlined.valid() && !is_region_op(graph.op(edit.inlined).kind)) return std::nullopt;
  try {
    Graph now = without_dead(Rewriter(graph, edit).run());
    if (!passes::verify(now).empty()) return std::nullopt;
    return now;
  } catch (const InternalError&) {  // types that do not fit, or a value that is gone
  } catch (const std::out_of_range&) {
  }
  return std::nullopt;
}

}  // namespace dr::test
