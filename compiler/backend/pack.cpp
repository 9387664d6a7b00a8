// SPDX-License-Identifier: Apache-2.0
// Packing: which ops share a shader. Naive gives each op a pass. Fused gives ops of one extent and one level
// (levels.h) a pass, and splits a pass where a limit of the profile is hit. Small cones over leaves and constants are
// recomputed where they are used instead of stored.
#include <algorithm>
#include <climits>
#include <functional>
#include <optional>
#include <set>

#include "compiler/backend/cost.h"
#include "compiler/backend/levels.h"
#include "compiler/backend/pack_stages.h"
#include "compiler/backend/pass_order.h"
#include "compiler/backend/schedule.h"
#include "compiler/backend/uses.h"
#include "compiler/ops/op.h"

namespace dr::backend {

using ir::Extent;
using ir::Graph;
using ir::Op;
using ir::OpId;
using ir::OpKind;
using ir::ValueId;

namespace {

constexpr int kNotCheap = 1 << 20;
// Longer shaders are not merged: drivers compile them slowly, and registers run out.
constexpr size_t kMaxMergedOps = 2000;

bool has_scatter(const Op& op) {
  return std::find(op.attrs.yields.begin(), op.attrs.yields.end(), ir::Yield::Scatter) != op.attrs.yields.end();
}

Pass::Kind pass_kind(const Op& op) {
  switch (op.kind) {
    case OpKind::ReduceSum:
    case OpKind::ReduceMin:
    case OpKind::ReduceMax: return Pass::Kind::Reduce;
    case OpKind::ScatterAdd:
    case OpKind::ScatterMax: return Pass::Kind::Scatter;
    case OpKind::Raster: return Pass::Kind::Raster;
    default: return has_scatter(op) ? Pass::Kind::Scatter : Pass::Kind::Map;
  }
}

// Elements over which an op's shader runs.
Extent domain_of(const Graph& graph, const Op& op) {
  switch (pass_kind(op)) {
    case Pass::Kind::Raster: return {op.attrs.dims[0], op.attrs.dims[1], op.attrs.dims[2]};
    case Pass::Kind::Scatter:
      if (!op.regions.empty()) return {op.attrs.dims[0], op.attrs.dims[1], op.attrs.dims[2]};
      return *ir::broadcast(graph.value(op.operands[0]).extent, graph.value(op.operands[1]).extent);
    case Pass::Kind::Reduce: return graph.value(op.operands[0]).extent;
    case Pass::Kind::Map: break;
  }
  return graph.value(op.results[0]).extent;
}

// Packs one step.
class StepPacker {
 public:
  StepPacker(const Graph& graph, const ir::Step& step, const target::Profile& profile, const PackOptions& options,
             std::vector<Resource>& resources, std::set<std::string>& names)
      : graph_(graph), profile_(profile), options_(options), resources_(resources), names_(names) {
    out_.name = step.name;
    recompute_limit_ = recompute_limit(profile, options.fragment);
    std::vector<ValueId> roots;
    for (const ir::Output& o : step.outputs) roots.push_back(o.value);
    for (const ir::Update& u : step.updates) roots.push_back(u.value);
    live_ = ir::live_ops(graph, roots);
    for (const ir::Output& o : step.outputs) out_.outputs.emplace_back(o.name, o.value);
    for (const ir::Update& u : step.updates) {
      out_.updates.emplace_back(u.leaf, u.value);
      updated_.insert(u.value);
    }
    roots_.insert(roots.begin(), roots.end());
  }

  StepSchedule process() {
    for (OpId id : graph_.region(graph_.root()).ops)
      if (live_[id.index]) order_.push_back(id);
    uses_.resize(graph_.op_count());
    for (OpId id : order_) uses_[id.index] = uses_of(graph_, graph_.op(id));
    find_recomputable();
    find_levels();
    find_stored();
    make_passes();
    if (options_.fused) merge_passes();
    pack_stages(graph_, out_, profile_, options_.stages);
    return std::move(out_);
  }

 private:
  const Op& def(ValueId v) const { return graph_.op(graph_.value(v).op); }
  bool recomputable(ValueId v) const {
    return recompute_cost_[graph_.value(v).op.index] <= (options_.recompute ? recompute_limit_ : 0);
  }

  void find_recomputable() {
    recompute_cost_.assign(graph_.op_count(), kNotCheap);
    for (OpId id : order_) {
      const Op& op = graph_.op(id);
      if (is_inline(op)) {
        recompute_cost_[id.index] = 0;
        continue;
      }
      if (!options_.recompute || is_memory(op)) continue;
      const bool element_wise = ops::info(op.kind).shape == ops::Shape::Elementwise || op.kind == OpKind::Broadcast;
      if (!element_wise) continue;
      int cost = op_cost(op.kind);
      for (ValueId v : op.operands) {
        const Op& from = def(v);
        if (!is_memory(from)) cost += recompute_cost_[graph_.value(v).op.index];
        cost = std::min(cost, kNotCheap);
      }
      recompute_cost_[id.index] = cost;
    }
  }

  void find_levels() {
    std::set<ValueId> elsewhere;
    for (OpId id : order_) elsewhere.insert(uses_[id.index].elsewhere.begin(), uses_[id.index].elsewhere.end());
    level_ =
        backend::find_levels({.graph = graph_,
                              .order = order_,
                              .uses = uses_,
                              .domain =
                                  [&](const Op& op) {
                                    const bool shares = options_.fused && pass_kind(op) == Pass::Kind::Map;
                                    return shares ? &graph_.value(op.results[0]).extent : nullptr;
                                  },
                              .recomputed = [&](ValueId v) { return recomputable(v); },
                              .stored = [&](ValueId v) { return roots_.count(v) != 0 || elsewhere.count(v) != 0; }});
  }

  // Whether `user` finds `v` computed in its own pass.
  bool in_same_pass(const Op& user, OpId user_id, ValueId v) const {
    const OpId from = graph_.value(v).op;
    return options_.fused && pass_kind(user) == Pass::Kind::Map && pass_kind(graph_.op(from)) == Pass::Kind::Map &&
           level_[from.index] == level_[user_id.index] && graph_.value(v).extent == domain_of(graph_, user);
  }

  void find_stored() {
    std::set<ValueId> stored;
    // Only ops that some pass really computes make demands; walk back from the roots.
    std::vector<bool> computed(graph_.op_count(), false);
    for (ValueId v : roots_) stored.insert(v);
    for (auto it = order_.rbegin(); it != order_.rend(); ++it) {
      const Op& op = graph_.op(*it);
      bool needed = computed[it->index];
      for (ValueId v : op.results) needed = needed || stored.count(v) != 0;
      if (!needed || is_memory(op)) continue;
      computed[it->index] = true;
      if (op.kind == OpKind::Pin) stored.insert(op.results[0]);  // what the program wants kept
      for (ValueId v : uses_[it->index].elsewhere) stored.insert(v);
      for (ValueId v : uses_[it->index].at_element) {
        if (is_memory(def(v))) continue;
        if (recomputable(v) || in_same_pass(op, *it, v))
          computed[graph_.value(v).op.index] = true;
        else
          stored.insert(v);
      }
    }
    stored_ = std::move(stored);
    for (OpId id : order_) {
      const Op& op = graph_.op(id);
      for (ValueId v : op.results) {
        const bool raster = op.kind == OpKind::Raster;  // all results of a raster exist together
        if (is_memory(op) || stored_.count(v) != 0 || (raster && any_stored(op))) add_resource(v, op);
      }
    }
  }

  bool any_stored(const Op& op) const {
    return std::any_of(op.results.begin(), op.results.end(), [&](ValueId v) { return stored_.count(v) != 0; });
  }
  void add_resource(ValueId v, const Op& op) {
    const ir::ValueInfo& info = graph_.value(v);
    if (op.kind == OpKind::Leaf) {
      const uint32_t leaf = *graph_.leaf_index(op.attrs.text);
      out_.stored[v] = ResourceId{leaf};  // leaves come first, in order
      return;
    }
    Resource r;
    r.type = info.type;
    r.extent = info.extent;
    r.step_index = op.kind == OpKind::StepIndex;
    r.name = unique_name(r.step_index        ? "step_index"
                         : info.name.empty() ? std::string(ir::op_name(op.kind))
                                             : info.name);
    const bool image_like = !info.extent.h.is_one() && !info.type.is_matrix() && updated_.count(v) == 0;
    const Pass::Kind kind = pass_kind(op);
    if ((kind == Pass::Kind::Map && !r.step_index && image_like && options_.fragment) ||
        (kind == Pass::Kind::Raster && options_.hardware_raster))
      r.storage = Resource::Storage::Image;
    resources_.push_back(r);
    out_.stored[v] = ResourceId{static_cast<uint32_t>(resources_.size() - 1)};
  }

  std::string unique_name(std::string base) {
    for (char& c : base)
      if (!std::isalnum(static_cast<unsigned char>(c))) c = '_';
    std::string name = base;
    for (int n = 2; !names_.insert(name).second; ++n) name = base + "_" + std::to_string(n);
    return name;
  }

  const Resource& resource(ValueId v) const { return resources_[out_.stored.at(v).index]; }

  // The ops that a shader must contain to compute `targets`, and the stored values it then reads. The pass runs after
  // all those of lower levels.
  void close_over(Pass& pass, const std::vector<ValueId>& targets, const std::set<OpId>& group, int level) const {
    std::set<OpId> ops;
    std::set<ValueId> reads, elsewhere, known_elsewhere;
    // A cheap value is computed again, unless it is there anyway and to load it is cheaper still, or done already.
    auto is_read = [&](ValueId v) {
      const uint32_t from = graph_.value(v).op.index;
      if (!recomputable(v)) return true;
      if (stored_.count(v) == 0 || level_[from] >= level) return false;
      return known_elsewhere.count(v) != 0 || 2 * recompute_cost_[from] > recompute_limit_;
    };
    std::function<void(OpId)> need = [&](OpId id) {
      if (!ops.insert(id).second) return;
      elsewhere.insert(uses_[id.index].elsewhere.begin(), uses_[id.index].elsewhere.end());
      for (ValueId v : uses_[id.index].at_element) {
        const OpId from = graph_.value(v).op;
        if (is_memory(graph_.op(from)) || spilled_.count(v) != 0 || (group.count(from) == 0 && is_read(v)))
          reads.insert(v);
        else
          need(from);
      }
    };
    // The second time it is known what the shader reads at other places.
    for (const int time : {1, 2}) {
      if (time == 2 && elsewhere.empty()) break;
      known_elsewhere = std::move(elsewhere);
      elsewhere = {};
      ops.clear();
      reads.clear();
      for (ValueId v : targets) need(graph_.value(v).op);
    }
    reads.insert(elsewhere.begin(), elsewhere.end());
    pass.ops.assign(ops.begin(), ops.end());
    std::sort(pass.ops.begin(), pass.ops.end(),
              [&](OpId a, OpId b) { return position_.at(a.index) < position_.at(b.index); });
    pass.reads.assign(reads.begin(), reads.end());
    pass.writes = targets;
    std::sort(pass.writes.begin(), pass.writes.end());
  }

  bool within_limits(const Pass& pass) const {
    std::set<uint32_t> buffers, images;
    for (ValueId v : pass.reads)
      (resource(v).storage == Resource::Storage::Image ? images : buffers).insert(out_.stored.at(v).index);
    uint32_t written = 0;
    for (ValueId v : pass.writes) {
      if (pass.hardware)
        ++written;
      else
        buffers.insert(out_.stored.at(v).index);
    }
    const uint32_t b = static_cast<uint32_t>(buffers.size()), i = static_cast<uint32_t>(images.size());
    if (b > profile_.max_per_stage_descriptor_storage_buffers || i > profile_.max_per_stage_descriptor_sampled_images)
      return false;
    if (b + i + written > profile_.max_per_stage_resources) return false;
    if (!pass.hardware) return true;
    return written <= profile_.max_color_attachments && b + written <= profile_.max_fragment_combined_output_resources;
  }

  // Of a pass that reads more than one shader may: the value of an op in it that reads most, among the operands of the
  // first op that reads too much. Invalid: an op alone reads too much.
  ValueId value_to_spill(const Pass& pass) const {
    std::map<OpId, std::set<ValueId>> reads;
    const std::set<ValueId> all(pass.reads.begin(), pass.reads.end());
    for (OpId id : pass.ops) {
      std::set<ValueId>& own = reads[id];
      ValueId most;
      for (ValueId v : uses_[id.index].elsewhere) own.insert(v);
      for (ValueId v : uses_[id.index].at_element) {
        const auto inside = reads.find(graph_.value(v).op);
        if (inside == reads.end()) {
          if (all.count(v) != 0) own.insert(v);
          continue;
        }
        own.insert(inside->second.begin(), inside->second.end());
        if (inside->second.size() > 1 && (!most.valid() || inside->second.size() > reads[graph_.value(most).op].size()))
          most = v;
      }
      Pass alone = pass;
      alone.reads.assign(own.begin(), own.end());
      alone.writes.resize(1);
      if (!within_limits(alone)) return most;
    }
    return {};
  }

  // A pass for one value that no shader can compute at once: parts of it are stored by passes of their own before.
  Pass spilling_pass(ValueId target, const Extent& domain, const std::set<OpId>& group, int level) {
    Pass pass;
    for (;;) {
      pass = {};
      pass.domain = domain;
      close_over(pass, {target}, group, level);
      if (within_limits(pass)) return pass;
      const ValueId v = value_to_spill(pass);
      if (!v.valid()) return pass;  // the checker says so
      if (stored_.insert(v).second) add_resource(v, def(v));
      resources_[out_.stored.at(v).index].storage = Resource::Storage::Buffer;
      if (written_.count(v) == 0) {
        Pass part = spilling_pass(v, domain, group, level);
        add_pass(std::move(part));
      }
      spilled_.insert(v);
    }
  }

  void add_pass(Pass pass) {
    written_.insert(pass.writes.begin(), pass.writes.end());
    pass.name = pass_name(pass);
    out_.passes.push_back(std::move(pass));
  }

  void add_map_passes(const Extent& domain, const std::vector<OpId>& group_ops, int level) {
    const std::set<OpId> group(group_ops.begin(), group_ops.end());
    std::vector<ValueId> images, buffers;
    for (OpId id : group_ops)
      for (ValueId v : graph_.op(id).results)
        if (stored_.count(v) != 0) (resource(v).storage == Resource::Storage::Image ? images : buffers).push_back(v);
    for (const bool hardware : {true, false}) {
      const std::vector<ValueId>& targets = hardware ? images : buffers;
      // As many of them into one shader as the limits allow; a cone two of the shaders need is computed twice.
      size_t next = 0;
      while (next < targets.size()) {
        Pass best;
        std::vector<ValueId> chosen;
        while (next < targets.size()) {
          if (written_.count(targets[next]) != 0) {
            ++next;
            continue;
          }
          chosen.push_back(targets[next]);
          Pass trial;
          trial.kind = Pass::Kind::Map;
          trial.hardware = hardware;
          trial.domain = domain;
          close_over(trial, chosen, options_.fused ? group : std::set<OpId>{graph_.value(chosen[0]).op}, level);
          const bool fits = within_limits(trial);
          if (chosen.size() > 1 && !fits) break;
          best = std::move(trial);
          ++next;
          if (!fits && hardware) {
            // One value alone needs more than a fragment shader may have: compute shaders may have more.
            best.hardware = false;
            resources_[out_.stored.at(chosen[0]).index].storage = Resource::Storage::Buffer;
            break;
          }
        }
        if (chosen.empty()) continue;
        if (!within_limits(best)) best = spilling_pass(chosen[0], domain, group, level);
        add_pass(std::move(best));
      }
    }
  }

  std::string pass_name(const Pass& pass) {
    std::string base;
    size_t count = 0;
    for (ValueId v : pass.writes)
      if (++count <= 3) base += (base.empty() ? "" : "_") + resource(v).name;
    if (count > 3) base += "_and_" + std::to_string(count - 3);
    return base;
  }

  void make_passes() {
    for (size_t k = 0; k < order_.size(); ++k) position_[order_[k].index] = k;
    int top = 0;
    for (OpId id : order_) top = std::max(top, level_[id.index]);
    for (int level = 0; level <= top; ++level) {
      // Map groups by extent, in order of their first op.
      std::vector<std::pair<Extent, std::vector<OpId>>> groups;
      std::vector<OpId> single;
      for (OpId id : order_) {
        const Op& op = graph_.op(id);
        if (level_[id.index] != level || is_memory(op)) continue;
        if (pass_kind(op) != Pass::Kind::Map) {
          if (any_stored(op)) single.push_back(id);
          continue;
        }
        const Extent domain = domain_of(graph_, op);
        auto group = std::find_if(groups.begin(), groups.end(), [&](const auto& g) { return g.first == domain; });
        if (!options_.fused || group == groups.end())
          groups.push_back({domain, {id}});
        else
          group->second.push_back(id);
      }
      for (const auto& [domain, members] : groups) add_map_passes(domain, members, level);
      for (OpId id : single) {
        const Op& op = graph_.op(id);
        Pass pass;
        pass.kind = pass_kind(op);
        pass.hardware = pass.kind == Pass::Kind::Raster && options_.hardware_raster;
        pass.domain = domain_of(graph_, op);
        std::vector<ValueId> targets;
        for (ValueId v : op.results)
          if (out_.stored.count(v) != 0) targets.push_back(v);
        close_over(pass, targets, {id}, level);
        pass.name = pass_name(pass);
        out_.passes.push_back(std::move(pass));
      }
    }
  }

  // One shader for both, where there can be one.
  std::optional<Pass> merged(const Pass& from, const Pass& into) {
    std::set<OpId> group(from.ops.begin(), from.ops.end());
    group.insert(into.ops.begin(), into.ops.end());
    if (group.size() > kMaxMergedOps) return std::nullopt;
    for (OpId id : into.ops)
      for (ValueId v : uses_[id.index].elsewhere)
        if (std::binary_search(from.writes.begin(), from.writes.end(), v)) return std::nullopt;
    std::vector<ValueId> targets = from.writes;
    targets.insert(targets.end(), into.writes.begin(), into.writes.end());
    int level = INT_MAX;
    for (ValueId v : targets) level = std::min(level, level_[graph_.value(v).op.index]);
    Pass both = into;
    close_over(both, targets, group, level);
    const bool own = std::ranges::any_of(
        both.reads, [&](ValueId v) { return std::binary_search(both.writes.begin(), both.writes.end(), v); });
    if (own || !within_limits(both)) return std::nullopt;
    both.name = pass_name(both);
    return both;
  }

  // Levels are shortest ways; passes of one extent that no other stands between may wait longer and share a shader.
  void merge_passes() {
    std::vector<Pass>& passes = out_.passes;
    PassOrder order(passes);
    std::map<std::pair<Extent, bool>, std::vector<size_t>> alike;
    for (size_t k = 0; k < passes.size(); ++k)
      if (passes[k].kind == Pass::Kind::Map) alike[{passes[k].domain, passes[k].hardware}].push_back(k);
    for (const auto& [key, members] : alike) {
      for (size_t i = 0; i < members.size(); ++i) {
        Pass& into = passes[members[i]];
        for (size_t j = 0; j < i && !into.writes.empty(); ++j) {
          Pass& from = passes[members[j]];
          if (from.writes.empty() || order.stand_apart(members[j], members[i])) continue;
          std::optional<Pass> both = merged(from, into);
          if (!both) continue;
          into = *std::move(both);
          from.writes.clear();
          order.merge(members[j], members[i]);
        }
      }
    }
    std::erase_if(passes, [](const Pass& pass) { return pass.writes.empty(); });
  }

  const Graph& graph_;
  const target::Profile& profile_;
  const PackOptions& options_;
  std::vector<Resource>& resources_;
  std::set<std::string>& names_;
  StepSchedule out_;
  std::vector<bool> live_;
  std::vector<OpId> order_;
  std::map<uint32_t, size_t> position_;
  std::vector<Uses> uses_;
  std::vector<int> recompute_cost_;
  int recompute_limit_ = 0;
  std::vector<int> level_;
  std::set<ValueId> roots_, updated_, stored_;
  std::set<ValueId> written_;  // by map passes so far
  std::set<ValueId> spilled_;  // stored because a shader would read too much otherwise
};

}  // namespace

Schedule pack(const Graph& graph, const target::Profile& profile, const PackOptions& options) {
  Schedule schedule;
  std::set<std::string> names;
  for (size_t k = 0; k < graph.leaves.size(); ++k) {
    const ir::Leaf& leaf = graph.leaves[k];
    Resource r;
    r.name = leaf.name;
    for (char& c : r.name)
      if (!std::isalnum(static_cast<unsigned char>(c))) c = '_';
    r.type = leaf.type;
    r.extent = leaf.extent;
    r.leaf = static_cast<int>(k);
    names.insert(r.name);
    schedule.resources.push_back(std::move(r));
  }
  for (const ir::Step& step : graph.steps)
    schedule.steps.push_back(StepPacker(graph, step, profile, options, schedule.resources, names).process());
  return schedule;
}

}  // namespace dr::backend
