// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/pack/transform_at_faces.h"

#include <algorithm>
#include <map>
#include <set>
#include <utility>

#include "compiler/backend/analysis/raster_parts.h"
#include "compiler/backend/analysis/uses.h"
#include "compiler/ops/emit.h"

namespace dr::backend {

using ir::Extent;
using ir::Graph;
using ir::Op;
using ir::OpId;
using ir::OpKind;
using ir::ValueId;

namespace {

// Additions that a corner may take, and components that it may load: those of one 16-byte load.
constexpr int kMostWork = 64;
constexpr int kMostLoaded = 4;

// One element of each layer, or one of all.
bool is_of_layers(const Extent& extent) { return extent.w.is_one() && extent.h.is_one(); }

// Whether a value is read where an index says, rather than computed there: a leaf, or what a list with layers makes of
// one that has none, but for the choice of components.
bool is_loaded(const Graph& graph, ValueId id, const Extent& of) {
  const ir::ValueInfo& info = graph.value(id);
  const Op& op = graph.op(info.op);
  return op.kind == OpKind::Leaf || (!of.l.is_one() && info.extent.l.is_one() && !ops::info(op.kind).moves);
}

// What a list is computed from, element by element; with layers, from lists that have none and from numbers of its
// layers.
class Cone {
 public:
  Cone(const Graph& graph, ValueId of) : graph_(graph), extent_(graph.value(of).extent) {
    sound_ = extent_.h.is_one() && !extent_.w.is_one() && visit(of) && loaded_ > 0;
  }

  // Whether it is cheap, and made of leaves and numbers.
  bool is_cheap() const { return sound_ && ops_ > 0 && work_ <= kMostWork && loaded_ <= kMostLoaded; }

 private:
  bool visit(ValueId id) {
    const ir::ValueInfo& info = graph_.value(id);
    if (is_of_layers(info.extent) || !seen_.insert(id).second) return true;
    if (info.type.is_matrix()) return false;
    if (info.extent != extent_ && info.extent != Extent{extent_.w, 1, 1}) return false;
    const Op& op = graph_.op(info.op);
    if (is_loaded(graph_, id, extent_)) {
      loaded_ += info.type.components();
      return true;
    }
    if (op.kind == OpKind::Broadcast) return is_of_layers(graph_.value(op.operands[0]).extent);
    const ops::OpInfo& entry = ops::info(op.kind);
    if (entry.shape != ops::Shape::Elementwise || op.kind == OpKind::Pin) return false;  // what is pinned is stored
    ++ops_;
    work_ += entry.moves ? 0 : entry.cost * info.type.components();
    return work_ <= kMostWork && std::ranges::all_of(op.operands, [&](ValueId v) { return visit(v); });
  }

  const Graph& graph_;
  const Extent extent_;
  std::set<ValueId> seen_;
  int ops_ = 0, work_ = 0, loaded_ = 0;
  bool sound_ = false;
};

// The reads by faces of a raster that are worth it.
class Finder {
 public:
  explicit Finder(const Graph& graph) : graph_(graph) {
    for (const ir::Step& step : graph.steps) steady_.push_back(steady_ops(graph, step));
  }

  std::set<OpId> run() const {
    const std::vector<OpId>& ops = graph_.region(graph_.root()).ops;
    std::vector<ir::Extent> faces;
    for (const OpId id : ops)
      if (const Op& op = graph_.op(id); op.kind == OpKind::Raster) {
        const RasterParts parts = raster_parts(op);
        faces.push_back({parts.faces, 1, parts.l});
      }
    std::set<OpId> out;
    for (const OpId id : ops) {
      const Op& op = graph_.op(id);
      if (op.kind != OpKind::Gather) continue;
      if (std::ranges::find(faces, graph_.value(op.results[0]).extent) == faces.end()) continue;
      if (is_worth_it(op)) out.insert(id);
    }
    return out;
  }

 private:
  bool is_worth_it(const Op& gather) const {
    const OpId from = graph_.value(gather.operands[0]).op;
    const bool changes = std::ranges::any_of(steady_, [&](const auto& steady) { return steady[from.index]; });
    return changes && graph_.value(gather.operands[1]).type == ir::kInt && Cone(graph_, gather.operands[0]).is_cheap();
  }

  const Graph& graph_;
  std::vector<std::vector<bool>> steady_;  // by step
};

class Mover : Rewriter {
 public:
  Mover(const Graph& from, std::set<OpId> gathers) : Rewriter(from), gathers_(std::move(gathers)) {}

  Joined run() {
    for (const OpId id : from_.region(from_.root()).ops) gathers_.count(id) == 0 ? copy(id) : move(id);
    return finish();
  }

 private:
  void move(OpId id) {
    const Op& gather = from_.op(id);
    const ValueId index = map_[gather.operands[1]];
    to_.set_span(gather.span);
    const ValueId value = at(gather.operands[0], gather.operands[1], from_.value(gather.operands[0]).extent);
    const ValueId behind = ops::dim_value(to_, from_.value(gather.operands[0]).extent.w);
    const ValueId zero = ops::constant(to_, ir::kInt, 0.0);
    const ValueId inside =
        ops::emit(to_, OpKind::LogicalAnd,
                  {ops::emit(to_, OpKind::LessEqual, {zero, index}), ops::emit(to_, OpKind::Less, {index, behind})});
    const ValueId result = ops::select(to_, inside, value, ops::zero_like(to_, value));
    to_.set_name(result, from_.value(gather.results[0]).name);
    map_.set(gather.results[0], result);
    match_rest(id);
    to_.set_span({});
  }

  // A value of the cone where an index says.
  ValueId at(ValueId v, ValueId index, const Extent& of) {
    const ir::ValueInfo& info = from_.value(v);
    if (is_of_layers(info.extent)) return map_[v];
    const auto [found, first] = at_.try_emplace({v, index});
    if (!first) return found->second;
    const Op& op = from_.op(info.op);
    ValueId out;
    if (is_loaded(from_, v, of)) {
      out = ops::emit(to_, OpKind::Gather, {map_[v], map_[index]});
    } else if (op.kind == OpKind::Broadcast) {
      out = map_[op.operands[0]];
    } else {
      std::vector<ValueId> operands;
      for (const ValueId operand : op.operands) operands.push_back(at(operand, index, of));
      out = ops::emit(to_, op.kind, std::move(operands), op.attrs);
      match_rest(info.op);
    }
    at_[{v, index}] = out;
    return out;
  }

  const std::set<OpId> gathers_;
  std::map<std::pair<ValueId, ValueId>, ValueId> at_;  // by old value and old index
};

}  // namespace

std::optional<Joined> transform_at_faces(const Graph& graph, const target::Profile& profile) {
  if (!profile.is_gpu()) return std::nullopt;
  std::set<OpId> gathers = Finder(graph).run();
  if (gathers.empty()) return std::nullopt;
  return Mover(graph, std::move(gathers)).run();
}

}  // namespace dr::backend
