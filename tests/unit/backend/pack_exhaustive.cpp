// SPDX-License-Identifier: Apache-2.0
#include "tests/unit/backend/pack_exhaustive.h"

#include <algorithm>
#include <functional>
#include <map>
#include <set>

#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/cost/cost.h"
#include "compiler/backend/pack/stages.h"
#include "compiler/ops/op.h"

namespace dr::backend_test {

using namespace dr::backend;
using ir::Op;
using ir::OpId;
using ir::OpKind;
using ir::ValueId;

namespace {

bool is_map(const Op& op) {
  return op.kind != OpKind::ReduceSum && op.kind != OpKind::ReduceMin && op.kind != OpKind::ReduceMax &&
         op.kind != OpKind::ScatterAdd && op.kind != OpKind::ScatterMax && op.kind != OpKind::Raster;
}

class Search {
 public:
  Search(const ir::Graph& graph, const target::Profile& profile, const PackOptions& options,
         const ir::SymbolValues& symbols, size_t most)
      : graph_(graph), profile_(profile), options_(options), symbols_(symbols), most_(most) {}

  std::optional<Best> process() {
    const ir::Step& step = graph_.steps[0];
    std::vector<ValueId> roots;
    for (const ir::Output& o : step.outputs) roots.push_back(o.value);
    const std::vector<bool> live = ir::live_ops(graph_, roots);
    std::set<ValueId> required(roots.begin(), roots.end());
    std::vector<ValueId> optional;
    for (OpId id : graph_.region(graph_.root()).ops) {
      const Op& op = graph_.op(id);
      if (!live[id.index] || is_inline(op) || is_memory(op)) continue;
      order_.push_back(id);
      uses_[id] = uses_of(graph_, op);
      for (ValueId v : uses_[id].elsewhere) required.insert(v);
      if (is_map(op)) continue;
      required.insert(op.results[0]);
    }
    for (OpId id : order_)
      if (required.count(graph_.op(id).results[0]) == 0) optional.push_back(graph_.op(id).results[0]);
    if (optional.size() > 16) return std::nullopt;
    for (uint32_t mask = 0; mask < 1u << optional.size(); ++mask) {
      stored_ = required;
      for (size_t k = 0; k < optional.size(); ++k)
        if ((mask >> k & 1) != 0) stored_.insert(optional[k]);
      choose_resources();
      targets_.clear();
      for (OpId id : order_)
        if (const ValueId v = graph_.op(id).results[0]; stored_.count(v) != 0 && is_map(graph_.op(id)))
          targets_.push_back(v);
      groups_.clear();
      if (!share(0)) return std::nullopt;
    }
    return std::move(best_);
  }

 private:
  void choose_resources() {
    schedule_ = {};
    StepSchedule& step = schedule_.steps.emplace_back();
    step.name = graph_.steps[0].name;
    for (const ir::Output& o : graph_.steps[0].outputs) step.outputs.emplace_back(o.name, o.value);
    for (size_t k = 0; k < graph_.leaves.size(); ++k) {
      const ir::Leaf& leaf = graph_.leaves[k];
      schedule_.resources.push_back({leaf.name, leaf.type, leaf.extent, Resource::Storage::Leaf});
    }
    for (OpId id : graph_.region(graph_.root()).ops) {
      const Op& op = graph_.op(id);
      if (op.kind == OpKind::Leaf) step.stored[op.results[0]] = ResourceId{*graph_.leaf_index(op.attrs.text)};
    }
    for (OpId id : order_) {
      const ValueId v = graph_.op(id).results[0];
      if (stored_.count(v) == 0) continue;
      const ir::ValueInfo& info = graph_.value(v);
      Resource r{"r" + std::to_string(v.index), info.type, info.extent};
      if (options_.fragment && is_map(graph_.op(id)) && !info.extent.h.is_one() && !info.type.is_matrix())
        r.storage = Resource::Storage::Image;
      step.stored[v] = ResourceId{static_cast<uint32_t>(schedule_.resources.size())};
      schedule_.resources.push_back(r);
    }
  }

  const Resource& resource(ValueId v) const { return schedule_.resources[schedule_.steps[0].stored.at(v).index]; }

  // Every way to put targets[k...] into the groups there are or new ones.
  bool share(size_t k) {
    if (k == targets_.size()) return evaluate();
    const Resource& r = resource(targets_[k]);
    for (size_t g = 0; g < groups_.size(); ++g) {
      const Resource& other = resource(groups_[g][0]);
      if (other.extent != r.extent || other.storage != r.storage) continue;
      groups_[g].push_back(targets_[k]);
      if (!share(k + 1)) return false;
      groups_[g].pop_back();
    }
    groups_.push_back({targets_[k]});
    if (!share(k + 1)) return false;
    groups_.pop_back();
    return true;
  }

  // The ops and reads of a shader for `targets`; false where it cannot be one.
  bool close_over(Pass& pass, const std::vector<ValueId>& targets) {
    const std::set<ValueId> own(targets.begin(), targets.end());
    std::set<OpId> ops;
    std::set<ValueId> reads;
    bool possible = true;
    std::function<void(OpId)> need = [&](OpId id) {
      if (!ops.insert(id).second) return;
      const Op& op = graph_.op(id);
      if (is_inline(op)) return;
      for (ValueId v : uses_[id].elsewhere) reads.insert(v);
      for (ValueId v : uses_[id].at_element) {
        const OpId from = graph_.value(v).op;
        const Op& def = graph_.op(from);
        if (is_memory(def) || (stored_.count(v) != 0 && own.count(v) == 0)) {
          reads.insert(v);
          continue;
        }
        const bool element_wise =
            is_inline(def) || ops::info(def.kind).shape == ops::Shape::Elementwise || def.kind == OpKind::Broadcast;
        if (!element_wise && graph_.value(v).extent != pass.domain) possible = false;
        if (own.count(v) != 0 && graph_.value(v).extent != pass.domain) possible = false;
        need(from);
      }
    };
    for (ValueId v : targets) need(graph_.value(v).op);
    for (ValueId v : reads) possible = possible && own.count(v) == 0;
    pass.ops.assign(ops.begin(), ops.end());  // in graph order: ids grow
    pass.reads.assign(reads.begin(), reads.end());
    pass.writes = targets;
    std::sort(pass.writes.begin(), pass.writes.end());
    for (OpId id : pass.ops) {
      const Op& op = graph_.op(id);
      const bool reads_places = op.kind == OpKind::Gather || op.kind == OpKind::Shift || !op.regions.empty();
      if (reads_places && !once_.insert(id).second) possible = false;
    }
    return possible;
  }

  bool evaluate() {
    if (++tried_ > most_) return false;
    once_.clear();
    std::vector<Pass> passes;
    for (const auto& group : groups_) {
      Pass& pass = passes.emplace_back();
      pass.domain = resource(group[0]).extent;
      if (resource(group[0]).is(Resource::Storage::Image)) pass.of_kind = FragmentPass{};
      if (!close_over(pass, group)) return true;
    }
    for (OpId id : order_) {
      const Op& op = graph_.op(id);
      if (is_map(op)) continue;
      Pass& pass = passes.emplace_back();
      const bool scatter = op.kind == OpKind::ScatterAdd || op.kind == OpKind::ScatterMax;
      if (scatter)
        pass.of_kind = ScatterPass{};
      else
        pass.of_kind = ReducePass{};
      pass.domain = scatter ? *ir::broadcast(graph_.value(op.operands[0]).extent, graph_.value(op.operands[1]).extent)
                            : graph_.value(op.operands[0]).extent;
      if (!close_over(pass, {op.results[0]})) return true;
    }
    // An order in which reads come after writes, if there is one.
    std::set<ValueId> ready;
    std::vector<Pass> ordered;
    std::vector<bool> done(passes.size(), false);
    for (bool more = true; more;) {
      more = false;
      for (size_t k = 0; k < passes.size(); ++k) {
        if (done[k] || std::any_of(passes[k].reads.begin(), passes[k].reads.end(), [&](ValueId v) {
              return ready.count(v) == 0 && !is_memory(graph_.op(graph_.value(v).op));
            }))
          continue;
        ready.insert(passes[k].writes.begin(), passes[k].writes.end());
        ordered.push_back(passes[k]);
        done[k] = more = true;
      }
    }
    if (ordered.size() != passes.size()) return true;
    StepSchedule& step = schedule_.steps[0];
    step.passes = std::move(ordered);
    pack_stages(graph_, step, profile_, options_.stages);
    const auto cost = step_cost(graph_, schedule_, step, profile_, symbols_);
    if (cost && (!best_ || *cost < best_->cost) && check_schedule(graph_, schedule_, profile_).empty()) {
      const size_t tried = tried_;
      best_ = Best{*cost, tried, schedule_};
    }
    if (best_) best_->tried = tried_;
    return true;
  }

  const ir::Graph& graph_;
  const target::Profile& profile_;
  const PackOptions& options_;
  const ir::SymbolValues& symbols_;
  size_t most_, tried_ = 0;
  std::vector<OpId> order_;
  std::map<OpId, Uses> uses_;
  std::set<ValueId> stored_;
  std::vector<ValueId> targets_;
  std::vector<std::vector<ValueId>> groups_;
  std::set<OpId> once_;  // ops that read other places, of the schedule at hand
  Schedule schedule_;
  std::optional<Best> best_;
};

}  // namespace

std::optional<Best> pack_exhaustive(const ir::Graph& graph, const target::Profile& profile, const PackOptions& options,
                                    const ir::SymbolValues& symbols, size_t most) {
  return Search(graph, profile, options, symbols, most).process();
}

}  // namespace dr::backend_test
