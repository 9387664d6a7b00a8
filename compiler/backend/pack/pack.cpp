// SPDX-License-Identifier: Apache-2.0
// Packing: which ops share a shader. Naive gives each op a pass. Fused gives ops of one extent and one level
// (levels.h) a pass, and splits a pass where a limit of the profile is hit. Small cones over leaves and constants are
// recomputed where they are used instead of stored.
#include <algorithm>

#include "compiler/backend/analysis/levels.h"
#include "compiler/backend/cost/cost.h"
#include "compiler/backend/pack/stages.h"
#include "compiler/backend/pack/step_packer.h"
#include "compiler/backend/schedule/trips.h"
#include "compiler/ir/raster.h"
#include "compiler/ops/op.h"

namespace dr::backend {

namespace {

constexpr int kNotCheap = 1 << 20;

// `base` as an identifier, with a number where others have that name.
std::string unique_name(Names& names, std::string base) {
  for (char& c : base)
    if (!std::isalnum(static_cast<unsigned char>(c))) c = '_';
  const auto [given, first] = names.try_emplace(base, 1);
  if (first) return base;
  for (;;) {
    std::string name = base + "_" + std::to_string(++given->second);
    if (names.try_emplace(name, 1).second) return name;
  }
}

}  // namespace

StepPacker::StepPacker(const Graph& graph, const ir::Step& step, const target::Profile& profile,
                       const PackOptions& options, std::vector<Resource>& resources, Names& names)
    : graph_(graph),
      step_(step),
      profile_(profile),
      options_(options),
      resources_(resources),
      names_(names),
      blocks_(graph, profile),
      position_(graph.op_count()),
      uses_(graph.op_count()),
      recompute_cost_(graph.op_count(), kNotCheap),
      size_(graph.op_count()),
      gathers_(graph.op_count()),
      loads_(graph.op_count()),
      looped_(graph.op_count()),
      absorbed_(graph.op_count()),
      users_(graph.value_count()),
      read_elsewhere_(graph.value_count()),
      stored_(graph.value_count()),
      resource_(graph.value_count()),
      written_(graph.value_count()),
      spilled_(graph.value_count()),
      group_(graph.op_count()),
      in_cone_(graph.op_count()),
      read_(graph.value_count()),
      elsewhere_(graph.value_count()) {
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

StepSchedule StepPacker::process() {
  for (OpId id : graph_.region(graph_.root()).ops)
    if (live_[id.index]) order_.push_back(id);
  for (uint32_t k = 0; k < order_.size(); ++k) {
    position_[order_[k].index] = k;
    uses_[order_[k].index] = uses_of(graph_, graph_.op(order_[k]));
    size_[order_[k].index] = op_size(graph_, graph_.op(order_[k]));
  }
  const auto moving = options_.moving.find(step_.name);
  steady_ = options_.prologue ? steady_ops(graph_, step_, order_, uses_,
                                           moving == options_.moving.end() ? std::set<std::string>{} : moving->second)
                              : std::vector<bool>(graph_.op_count(), true);
  find_users();
  find_looped();
  find_recomputable();
  if (options_.fused && options_.recompute) find_absorbed();
  find_levels();
  find_stored();
  make_passes();
  if (options_.fused) {
    store_later();
    merge_passes();
  }
  pack_stages(graph_, out_, profile_, options_.stages);
  return std::move(out_);
}

bool StepPacker::recomputable(ValueId v, OpId user) const {
  const uint32_t from = graph_.value(v).op.index;
  const int cost = recompute_cost_[from];
  // What the prologue stores for good is not read from other places again and again.
  if ((gathers_[from] || loads_[from]) && user.valid() && steady_[user.index] != steady_[from]) return false;
  // A scatter's shader runs twice; that of a region for few elements, see lowering/scatter_active.h.
  const bool twice =
      user.valid() &&
      (absorbed_[user.index] || (pass_kind(graph_.op(user)) == PassKind::Scatter && graph_.op(user).regions.empty()));
  const int times = twice ? 2 : 1;
  return cost == 0 || times * cost <= (options_.recompute ? recompute_limit_ : 0);
}

// Components that a lane of a gather loads. Lanes of a layer that read one place share what comes of it.
int StepPacker::loads_of(const ir::ValueInfo& gathered) const {
  constexpr int kShare = 16;
  const int components = gathered.type.components();
  const bool shared = profile_.is_gpu() && gathered.extent.w.is_one() && gathered.extent.h.is_one();
  return shared ? (components + kShare - 1) / kShare : components;
}

void StepPacker::find_recomputable() {
  // The limit stands for a component stored and loaded. What is stored anyway and loaded once more is mostly in a
  // cache.
  const int load_cost = std::max(recompute_limit_ / 8, 1);
  for (OpId id : order_) {
    const Op& op = graph_.op(id);
    if (is_inline(op)) {
      recompute_cost_[id.index] = 0;
      continue;
    }
    if (!options_.recompute || is_memory(op)) continue;
    const bool element_wise = ops::info(op.kind).shape == ops::Shape::Elementwise || op.kind == OpKind::Broadcast;
    const bool gather = op.kind == OpKind::Gather || op.kind == OpKind::Shift;  // what it reads is stored anyway
    if (!element_wise && !gather) continue;
    gathers_[id.index] = gather;
    int cost = gather ? load_cost * loads_of(graph_.value(op.results[0])) : op_cost(op.kind);
    for (ValueId v : uses_[id.index].at_element) {
      const uint32_t from = graph_.value(v).op.index;
      if (is_memory(def(v))) continue;
      if (recompute_cost_[from] > recompute_limit_ && stored_anyway(v)) {
        cost += load_cost * graph_.value(v).type.components();
        loads_[id.index] = true;
        continue;
      }
      cost += recompute_cost_[from];
      if (gathers_[from]) gathers_[id.index] = true;
      if (loads_[from]) loads_[id.index] = true;
      cost = std::min(cost, kNotCheap);
    }
    recompute_cost_[id.index] = cost;
  }
}

// Fragment shaders cannot stop within a loop and go on later (emit/cut.cpp).
void StepPacker::find_looped() {
  // Several that are not among these may share a shader.
  constexpr int64_t kShared = 16;
  for (OpId id : order_)
    looped_[id.index] =
        needs_cut(trips_of(graph_, std::span(&id, 1)), profile_, kShared) ||
        std::ranges::any_of(uses_[id.index].at_element, [&](ValueId v) { return looped_[graph_.value(v).op.index]; });
}

void StepPacker::find_users() {
  for (OpId id : order_) {
    for (ValueId v : uses_[id.index].at_element) users_[v.index].push_back(id);
    for (ValueId v : uses_[id.index].elsewhere) {
      users_[v.index].push_back(id);
      read_elsewhere_[v.index] = true;
    }
  }
}

void StepPacker::find_levels() {
  // All of the prologue comes before the rest, which need not wait for any of it.
  std::vector<OpId> prologue, rest;
  for (OpId id : order_) (steady_[id.index] ? rest : prologue).push_back(id);
  const auto absorbed = [&](ValueId v) { return absorbed_[graph_.value(v).op.index]; };
  const auto levels = [&](const std::vector<OpId>& order, bool steady) {
    return backend::find_levels(
        {.graph = graph_,
         .order = order,
         .uses = uses_,
         .domain =
             [&](const Op& op) {
               const ValueId v = op.results[0];
               const bool shares = options_.fused && pass_kind(op) == PassKind::Map && !absorbed(v);
               return shares ? &graph_.value(v).extent : nullptr;
             },
         .recomputed = [&](ValueId v, OpId user) { return recomputable(v, user); },
         .loads = [&](ValueId v) { return loads_[graph_.value(v).op.index]; },
         .stored = [&](ValueId v) { return roots_.count(v) != 0 || read_elsewhere_[v.index]; },
         .absorbed = absorbed,
         .ready = [&](ValueId v) { return is_memory(def(v)) || (steady && !steady_[graph_.value(v).op.index]); }});
  };
  level_ = levels(prologue, false);
  const std::vector<int> of_rest = levels(rest, true);
  int first = 0;
  for (OpId id : prologue)
    if (!is_memory(graph_.op(id))) first = std::max(first, level_[id.index] + 1);
  for (OpId id : rest) level_[id.index] = first + of_rest[id.index];
}

// Whether `user` finds `v` computed in its own pass.
bool StepPacker::in_same_pass(const Op& user, OpId user_id, ValueId v) const {
  const OpId from = graph_.value(v).op;
  if (absorbed_[from.index]) return true;
  return options_.fused && !absorbed_[user_id.index] && pass_kind(user) == PassKind::Map &&
         pass_kind(graph_.op(from)) == PassKind::Map && level_[from.index] == level_[user_id.index] &&
         graph_.value(v).extent == domain_of(graph_, user);
}

void StepPacker::find_stored() {
  // Only ops that some pass really computes make demands; walk back from the roots.
  std::vector<bool> computed(graph_.op_count(), false);
  for (ValueId v : roots_) stored_[v.index] = true;
  for (auto it = order_.rbegin(); it != order_.rend(); ++it) {
    const Op& op = graph_.op(*it);
    bool needed = computed[it->index];
    for (ValueId v : op.results) needed = needed || stored_[v.index];
    if (!needed || is_memory(op)) continue;
    computed[it->index] = true;
    if (op.kind == OpKind::Pin) stored_[op.results[0].index] = true;  // what the program wants kept
    for (ValueId v : uses_[it->index].elsewhere) stored_[v.index] = true;
    for (ValueId v : uses_[it->index].at_element) {
      if (is_memory(def(v))) continue;
      if (recomputable(v, *it) || in_same_pass(op, *it, v))
        computed[graph_.value(v).op.index] = true;
      else
        stored_[v.index] = true;
    }
  }
  for (OpId id : order_) {
    const Op& op = graph_.op(id);
    for (ValueId v : op.results) {
      const bool raster = op.kind == OpKind::Raster;  // all results of a raster exist together
      if (is_memory(op) || stored_[v.index] || (raster && any_stored(op))) add_resource(v, op);
    }
  }
}

bool StepPacker::any_stored(const Op& op) const {
  return std::any_of(op.results.begin(), op.results.end(), [&](ValueId v) { return stored_[v.index]; });
}

bool StepPacker::is_image(ValueId v) const {
  const ir::ValueInfo& info = graph_.value(v);
  const Op& op = def(v);
  const PassKind kind = pass_kind(op);
  if (is_memory(op) || kind != PassKind::Map) return kind == PassKind::Raster && drawn(op);
  if (looped_[info.op.index]) return false;
  return options_.fragment && !info.extent.h.is_one() && !info.type.is_matrix() && updated_.count(v) == 0;
}

bool StepPacker::drawn(const Op& raster) const {
  // Lists are made by atomics.
  return options_.hardware_raster && !ir::lists_faces(raster.attrs) &&
         !needs_cut(trips_of_regions(graph_, raster), profile_);
}

void StepPacker::add_resource(ValueId v, const Op& op) {
  const ir::ValueInfo& info = graph_.value(v);
  if (op.kind == OpKind::Leaf) {
    const uint32_t leaf = *graph_.leaf_index(op.attrs.text);
    out_.stored[v] = ResourceId{leaf};  // leaves come first, in order
    resource_[v.index] = leaf;
    return;
  }
  const bool counter = op.kind == OpKind::StepIndex;
  // A step has one counter, however many ops read it.
  if (counter && counter_) {
    resource_[v.index] = counter_->index;
    out_.stored[v] = *counter_;
    return;
  }
  Resource r;
  r.type = info.type;
  r.extent = info.extent;
  r.name = unique_name(names_, counter             ? "step_index"
                               : info.name.empty() ? std::string(ir::op_name(op.kind))
                                                   : info.name);
  // What the host reads and what leaves take is whole.
  const bool output = std::ranges::any_of(step_.outputs, [&](const ir::Output& o) { return o.value == v; });
  if (counter)
    r.storage = Resource::Storage::StepIndex;
  else if (is_image(v))
    r.storage = Resource::Storage::Image;
  else if (!output && updated_.count(v) == 0 && is_packed(graph_, v))
    r.storage = Resource::Storage::Halves;
  resources_.push_back(r);
  resource_[v.index] = static_cast<uint32_t>(resources_.size() - 1);
  out_.stored[v] = ResourceId{resource_[v.index]};
  if (counter) counter_ = out_.stored[v];
}

Schedule pack(const Graph& graph, const target::Profile& profile, const PackOptions& options) {
  Schedule schedule;
  Names names;
  for (size_t k = 0; k < graph.leaves.size(); ++k) {
    const ir::Leaf& leaf = graph.leaves[k];
    Resource r;
    r.name = unique_name(names, leaf.name);  // `a.b` of an instance and `a_b` are two
    r.type = leaf.type;
    r.extent = leaf.extent;
    r.storage = Resource::Storage::Leaf;
    schedule.resources.push_back(std::move(r));
  }
  for (const ir::Step& step : graph.steps)
    schedule.steps.push_back(StepPacker(graph, step, profile, options, schedule.resources, names).process());
  return schedule;
}

}  // namespace dr::backend
