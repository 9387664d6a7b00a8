// SPDX-License-Identifier: Apache-2.0
// What a region computes of values that no step changes, so that its scatters know where to add, moves out of it. The
// backend keeps values of the root region that stay as they are from run to run, and can sort by them.
//   if %c yields [scatter] { %i = f(%uv); yield %i, %dirty }    =>    %i = f(%uv); if %c ... { yield %i, %dirty }
// Ops of a region have no effects and are defined for every input, so they may run where a condition is false.
// Requires: no Grad op.  Establishes: where all indices that an If scatters at are clean and it is not, what is clean
// in it is defined in the root region, but for constants and a few cheap ops next to the rest.
#include <algorithm>
#include <set>
#include <string>

#include "compiler/ir/yields.h"
#include "compiler/ops/op.h"
#include "compiler/passes/copy_steps.h"
#include "compiler/passes/passes.h"

namespace dr::passes {

using namespace ir;

namespace {

// Ops that are no more than what it costs to load their result.
bool is_tail(const Graph& graph, const Op& op) {
  switch (ops::info(op.kind).recompute) {
    case ops::Recompute::Load: return false;
    case ops::Recompute::Always: return true;
    case ops::Recompute::OfConstant:
      return std::ranges::any_of(op.operands, [&](ValueId v) {
        return graph.value(v).op.valid() && graph.op(graph.value(v).op).kind == OpKind::Const;
      });
  }
  return false;
}

bool is_inline(const Op& op) {
  return op.kind == OpKind::Const || op.kind == OpKind::DimValue || op.kind == OpKind::Coord;
}

// Root ops of a step that depend on what it changes, and those that it needs.
struct StepOps {
  std::vector<bool> dirty, live;  // by OpId index
};

StepOps ops_of(const Graph& graph, const Step& step) {
  StepOps out{std::vector<bool>(graph.op_count()), {}};
  std::set<std::string> changed;
  std::vector<ValueId> roots;
  for (const Output& output : step.outputs) roots.push_back(output.value);
  for (const Update& update : step.updates) {
    roots.push_back(update.value);
    changed.insert(graph.leaves[update.leaf].name);
  }
  if (roots.empty())
    out.live.assign(graph.op_count(), false);
  else
    out.live = live_ops(graph, roots);
  for (const OpId id : graph.region(graph.root()).ops) {
    const Op& op = graph.op(id);
    out.dirty[id.index] =
        op.kind == OpKind::StepIndex || (op.kind == OpKind::Leaf && changed.count(op.attrs.text) != 0) ||
        std::ranges::any_of(needs_of(graph, op), [&](ValueId v) { return out.dirty[graph.value(v).op.index]; });
  }
  return out;
}

class Hoister {
 public:
  explicit Hoister(const Graph& from)
      : from_(from),
        map_(from.value_count()),
        dirty_(from.op_count()),
        hoisted_(from.op_count()),
        kept_(from.op_count()) {}

  Graph run() {
    to_.reserve(from_.op_count());
    to_.graph().leaves = from_.leaves;
    for (const OpId id : from_.region(from_.root()).ops) {
      order_.clear();
      if (is_candidate(id)) keep(id);
      for (const OpId moved : order_) copy_op(from_, moved, to_, map_);
      order_.empty() ? copy_op(from_, id, to_, map_) : copy_kept(id);
    }
    to_.graph().steps = copy_steps(from_, map_);
    return std::move(to_).finish();
  }

 private:
  bool is_root(ValueId v) const { return from_.value(v).region == from_.root(); }

  bool is_candidate(OpId id) {
    const Op& op = from_.op(id);
    if (op.kind != OpKind::If) return false;
    const auto scatters = [](Yield how) { return how == Yield::Scatter; };
    if (std::ranges::none_of(op.attrs.yields, scatters)) return false;
    if (steps_.empty())
      for (const Step& step : from_.steps) steps_.push_back(ops_of(from_, step));
    of_if_.clear();
    for (const StepOps& step : steps_)
      if (step.live[id.index]) of_if_.push_back(&step);
    if (!is_dirty(op.results[0])) return false;
    for (const RegionId region : op.regions) find_dirty(region);
    std::set<OpId> clean;
    return has_clean_indices(op, clean);
  }

  bool is_dirty(ValueId v) const {
    const OpId op = from_.value(v).op;
    if (!op.valid()) return false;
    if (!is_root(v)) return dirty_[op.index];
    return std::ranges::any_of(of_if_, [&](const StepOps* step) { return step->dirty[op.index]; });
  }

  void find_dirty(RegionId region) {
    for (const OpId id : from_.region(region).ops) {
      const Op& op = from_.op(id);
      dirty_[id.index] = std::ranges::any_of(needs_of(from_, op), [&](ValueId v) { return is_dirty(v); });
      if (op.kind != OpKind::If) continue;  // what loops hold stays there
      for (const RegionId inner : op.regions) find_dirty(inner);
    }
  }

  // `clean`: inner ops of which that is known, as they have several results.
  bool has_clean_indices(const Op& op, std::set<OpId>& clean) const {
    for (const RegionId region : op.regions) {
      const std::vector<Yielded> parts = yielded(from_, op, region);
      for (size_t k = 0; k < parts.size(); ++k) {
        if (op.attrs.yields[k] != Yield::Scatter) continue;
        if (parts[k].index.valid() && is_dirty(parts[k].index)) return false;
        if (parts[k].index.valid()) continue;
        const OpId by = from_.value(parts[k].value).op;
        if (clean.contains(by)) continue;
        if (from_.op(by).kind != OpKind::If || !has_clean_indices(from_.op(by), clean)) return false;
        clean.insert(by);
      }
    }
    return true;
  }

  // An op that stays, and what it needs.
  void keep(OpId id) {
    if (kept_[id.index]) return;
    kept_[id.index] = true;
    const Op& op = from_.op(id);
    for (const ValueId v : op.operands) decide(v);
    for (const RegionId region : op.regions)
      for (const ValueId v : op.kind == OpKind::If ? from_.region(region).yields : captures(from_, region)) decide(v);
  }

  // Whether the op of a value that something which stays needs stays, too. So does what scatters: the op around it goes
  // on with that sum.
  void decide(ValueId v) {
    if (is_root(v) || !from_.value(v).op.valid()) return;
    const OpId id = from_.value(v).op;
    const Op& op = from_.op(id);
    if (dirty_[id.index] || from_.value(v).accumulation || is_inline(op) || is_tail(from_, op))
      keep(id);
    else
      hoist(id);
  }

  void hoist(OpId id) {
    if (hoisted_[id.index]) return;
    hoisted_[id.index] = true;
    for (const ValueId v : needs_of(from_, from_.op(id)))
      if (!is_root(v)) hoist(from_.value(v).op);
    order_.push_back(id);
  }

  // What stays of an op, regions and all. What has moved is in the map already; a tail that moved, too, for the sake of
  // others stands in both places.
  void copy_kept(OpId id) {
    const Op& op = from_.op(id);
    if (op.kind != OpKind::If) return copy_op(from_, id, to_, map_);
    std::vector<RegionId> regions;
    for (const RegionId region : op.regions) {
      regions.push_back(to_.begin_region({}));
      for (const OpId inner : from_.region(region).ops)
        if (kept_[inner.index]) copy_kept(inner);
      to_.end_region(mapped(from_.region(region).yields));
    }
    std::vector<ResultType> types;
    for (const ValueId v : op.results) {
      const ValueInfo& info = from_.value(v);
      types.push_back({info.type, info.extent, info.accumulation});
    }
    const OpId now = to_.add(op.kind, mapped(op.operands), types, op.attrs, std::move(regions), op.span);
    for (size_t k = 0; k < op.results.size(); ++k) {
      map_.set(op.results[k], to_.graph().op(now).results[k]);
      if (const std::string& name = from_.value(op.results[k]).name; !name.empty())
        to_.set_name(map_[op.results[k]], name);
    }
  }

  std::vector<ValueId> mapped(const std::vector<ValueId>& values) const {
    std::vector<ValueId> out;
    for (const ValueId v : values) out.push_back(map_[v]);
    return out;
  }

  const Graph& from_;
  Builder to_;
  ValueMap map_;
  std::vector<StepOps> steps_;         // made when there is an If to look at
  std::vector<const StepOps*> of_if_;  // those that need the If at hand
  std::vector<bool> dirty_;            // by OpId index, of ops inside of regions
  std::vector<bool> hoisted_, kept_;   // by OpId index; an op of a region belongs to one root op
  std::vector<OpId> order_;            // that move before the If at hand
};

}  // namespace

Graph hoist_indices(const Graph& graph, const Skips& /*skips*/) { return Hoister(graph).run(); }

}  // namespace dr::passes
