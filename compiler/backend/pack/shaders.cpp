// SPDX-License-Identifier: Apache-2.0
// Shaders from what is stored: as many values of one extent and level into one shader as the limits allow, then passes
// that may share one after all.
#include <algorithm>
#include <climits>
#include <tuple>
#include <utility>

#include "compiler/backend/pack/pass_order.h"
#include "compiler/backend/pack/step_packer.h"
#include "compiler/backend/schedule/trips.h"

namespace dr::backend {

namespace {

// Longer shaders are not merged: drivers compile them slowly, and registers run out.
constexpr size_t kMaxMergedOps = 2000;
// A pass is merged with one of so many before it, and among so many passes, which keeps packing near linear.
constexpr size_t kMergeReach = 64, kMergeWindow = 4096;

// Where lanes go in turn, a map may list its heavy elements, and those that a scatter runs for.
uint32_t more_buffers(const target::Profile& profile, const Pass& pass) {
  if (pass.is<ScatterPass>()) return kScatterBuffers;
  return profile.lanes_in_turn && pass.is<MapPass>() ? kMapLists : 0;
}

Pass map_pass(bool hardware) {
  Pass pass;
  if (hardware) pass.of_kind = FragmentPass{};
  return pass;
}

bool is_in(const std::vector<ValueId>& sorted, ValueId v) {
  return std::binary_search(sorted.begin(), sorted.end(), v);
}

}  // namespace

// ---- what a shader holds ----

void StepPacker::set_group(std::span<const OpId> ops) {
  group_.clear();
  for (OpId id : ops) group_.add(id.index);
}

// Of a pass that runs after all those of lower levels.
void StepPacker::begin_cone(int level) {
  cone_ = {};
  cone_level_ = level;
  in_cone_.clear();
  read_.clear();
  read_resource_.clear();
  read_resource_.cover(resources_.size());
}

// A cheap value is computed again, unless it is there anyway and to load it is cheaper still, or done already.
bool StepPacker::is_read(ValueId v, OpId user) const {
  const uint32_t from = graph_.value(v).op.index;
  if (absorbed_[from]) return false;
  if (!recomputable(v, user)) return true;
  if (!stored_[v.index] || level_[from] >= cone_level_) return false;
  return elsewhere_.has(v.index) || 2 * recompute_cost_[from] > recompute_limit_;
}

// Whether `user`, in the shader at hand, has `v` loaded rather than computed; but for what has just been spilled.
bool StepPacker::is_loaded(ValueId v, OpId user) const {
  const OpId from = graph_.value(v).op;
  return is_memory(graph_.op(from)) || (!group_.has(from.index) && is_read(v, user));
}

// Adds what `target` takes to the cone, until that is larger than `most`.
void StepPacker::grow(ValueId target, size_t most) {
  const auto read = [&](ValueId v) {
    if (!read_.add(v.index)) return;
    cone_.reads.push_back(v);
    if (read_resource_.add(resource_index(v)))
      ++(resource(v).is(Resource::Storage::Image) ? cone_.images : cone_.buffers);
  };
  const auto need = [&](OpId id) {
    if (!in_cone_.add(id.index)) return;
    cone_.ops.push_back(id);
    cone_.size += size_[id.index];
  };
  size_t next = cone_.ops.size();
  need(graph_.value(target).op);
  for (; next < cone_.ops.size() && cone_.size <= most; ++next) {
    const OpId id = cone_.ops[next];
    const Uses& uses = uses_[id.index];
    for (ValueId v : uses.elsewhere) read(v);
    for (ValueId v : uses.at_element) {
      const OpId from = graph_.value(v).op;
      (spilled_[v.index] && v != target) || is_loaded(v, id) ? read(v) : need(from);
    }
  }
}

// The shader for `targets`, ops of the group among its own.
void StepPacker::close_over(Pass& pass, const std::vector<ValueId>& targets, int level) {
  elsewhere_.clear();
  // The second time it is known what the shader reads at other places: it need not be computed again.
  for (const int time : {1, 2}) {
    begin_cone(level);
    for (ValueId v : targets) grow(v);
    if (time == 2) break;
    bool any = false;
    for (OpId id : cone_.ops)
      for (ValueId v : uses_[id.index].elsewhere) any = elsewhere_.add(v.index) || any;
    if (!any) break;
  }
  pass.ops = cone_.ops;
  std::sort(pass.ops.begin(), pass.ops.end(), [&](OpId a, OpId b) { return position_[a.index] < position_[b.index]; });
  pass.reads = cone_.reads;
  std::sort(pass.reads.begin(), pass.reads.end());
  pass.writes = targets;
  std::sort(pass.writes.begin(), pass.writes.end());
}

// ---- limits ----

bool StepPacker::within_limits(const Pass& pass) const {
  std::set<uint32_t> written;
  std::vector<uint32_t> reads;
  for (ValueId v : pass.writes) written.insert(resource_index(v));
  for (ValueId v : pass.reads) reads.push_back(resource_index(v));
  Bindings all = bindings_of(resources_, std::move(reads), written.size(), pass.is_drawn());
  all.more += more_buffers(profile_, pass);
  return fits_with_loops(all, pass.ops);
}

// Of a shader with these ops: one whose loops are cut also binds where they stopped, in two buffers, and what tells
// that data made one too long.
bool StepPacker::fits_with_loops(Bindings all, std::span<const OpId> ops) const {
  if (!fits(profile_, all)) return false;
  all.more += all.hardware ? 0 : kCutBuffers;
  return fits(profile_, all) || !needs_cut(trips_of(graph_, ops), profile_);
}

// Parts of a pass that reads more than one shader may are stored by passes of their own before. Walks its ops: where
// one would read too much, the operand that takes most is cut off. An op alone that reads too much stays, for
// join_captures.
void StepPacker::spill(const Pass& pass) {
  std::map<OpId, std::vector<uint32_t>> reads;  // resources, sorted: what an op and those before it read
  const auto unite = [](std::vector<uint32_t>& all, const std::vector<uint32_t>& more) {
    std::vector<uint32_t> both;
    std::set_union(all.begin(), all.end(), more.begin(), more.end(), std::back_inserter(both));
    all = std::move(both);
  };
  for (OpId id : pass.ops) {
    for (;;) {
      std::vector<uint32_t> own;
      ValueId most;
      size_t most_reads = 1;
      for (ValueId v : uses_[id.index].elsewhere) unite(own, {resource_index(v)});
      for (ValueId v : uses_[id.index].at_element) {
        const auto inside = reads.find(graph_.value(v).op);
        if (inside == reads.end() || spilled_[v.index]) {
          if (spilled_[v.index] || is_in(pass.reads, v)) unite(own, {resource_index(v)});
          continue;
        }
        unite(own, inside->second);
        if (inside->second.size() > most_reads) most = v, most_reads = inside->second.size();
      }
      Bindings all = bindings_of(resources_, own, 1, pass.is_drawn());
      all.more += more_buffers(profile_, pass);
      if (fits(profile_, all) || !most.valid()) {
        reads[id] = std::move(own);
        break;
      }
      store_before(most, pass.domain);
    }
  }
}

// ---- passes ----

void StepPacker::add_pass(Pass pass) {
  if (pass.kind() == PassKind::Map)
    for (ValueId v : pass.writes) written_[v.index] = true;
  pass.steady = steady_[graph_.value(pass.writes[0]).op.index];
  pass.name = pass_name(pass);
  out_.passes.push_back(std::move(pass));
}

std::string StepPacker::pass_name(const Pass& pass) const {
  std::string base;
  size_t count = 0;
  for (ValueId v : pass.writes)
    if (++count <= 3) base += (base.empty() ? "" : "_") + resource(v).name;
  if (count > 3) base += "_and_" + std::to_string(count - 3);
  return base;
}

void StepPacker::add_map_passes(const Extent& domain, const std::vector<OpId>& group, int level) {
  std::vector<ValueId> images, buffers, all;
  for (OpId id : group)
    for (ValueId v : graph_.op(id).results)
      if (stored_[v.index]) all.push_back(v);
  set_group(group);
  if (options_.fused) cut(domain, all, level);
  for (ValueId v : all) (resource(v).is(Resource::Storage::Image) ? images : buffers).push_back(v);
  for (const bool hardware : {true, false}) {
    const std::vector<ValueId>& targets = hardware ? images : buffers;
    std::span<const ValueId> rest = targets;
    const std::vector<ValueId> first = choose(rest, level, hardware);
    if (rest.empty() && !first.empty()) {
      add_map_pass(domain, first, level, hardware);
      continue;
    }
    for (const std::vector<ValueId>& together : gathered(targets, std::max<size_t>(first.size(), 1), domain, level))
      for (rest = together; !rest.empty();)
        if (const auto chosen = choose(rest, level, hardware); !chosen.empty())
          add_map_pass(domain, chosen, level, hardware);
  }
}

// As many of the first of `targets` as the limits allow in one shader, or one that no shader can have; takes them
// away. What two shaders need is computed twice.
std::vector<ValueId> StepPacker::choose(std::span<const ValueId>& targets, int level, bool hardware) {
  std::vector<ValueId> chosen;
  const uint32_t more = more_buffers(profile_, map_pass(hardware));
  elsewhere_.clear();
  begin_cone(level);
  for (; !targets.empty(); targets = targets.subspan(1)) {
    const ValueId v = targets.front();
    if (written_[v.index]) continue;
    grow(v);
    const auto count = static_cast<uint32_t>(chosen.size()) + 1;
    if (fits_with_loops({cone_.buffers, cone_.images, count, hardware, more}, cone_.ops) &&
        (count == 1 || cone_.size <= kMaxSize)) {
      chosen.push_back(v);
      continue;
    }
    if (!chosen.empty()) return chosen;
    targets = targets.subspan(1);
    return {v};
  }
  return chosen;
}

// Targets of which a shader can have about `most`, those that read the same beside each other; a list ends where what
// follows would be torn apart, unless that takes a shader more.
std::vector<std::vector<ValueId>> StepPacker::gathered(std::span<const ValueId> targets, size_t most,
                                                       const Extent& domain, int level) {
  std::vector<std::pair<std::vector<ValueId>, ValueId>> by_reads;
  elsewhere_.clear();
  for (ValueId v : targets) {
    begin_cone(level);
    grow(v);
    std::erase_if(cone_.reads, [&](ValueId read) { return is_small(graph_.value(read).extent, domain); });
    std::sort(cone_.reads.begin(), cone_.reads.end());
    by_reads.emplace_back(cone_.reads, v);
  }
  std::sort(by_reads.begin(), by_reads.end());
  std::vector<std::vector<ValueId>> out(1);
  size_t spare = (most - targets.size() % most) % most;
  for (size_t k = 0; k < by_reads.size(); ++k) {
    const size_t room = most - out.back().size() % most;
    const bool others = k > 0 && by_reads[k].first != by_reads[k - 1].first;
    if (others && room < most && room <= spare) {
      const auto alike = std::ranges::find_if(by_reads.begin() + static_cast<std::ptrdiff_t>(k), by_reads.end(),
                                              [&](const auto& other) { return other.first != by_reads[k].first; });
      const auto count = static_cast<size_t>(alike - by_reads.begin()) - k;
      if (count > room && count <= most) {
        spare -= room;
        out.emplace_back();
      }
    }
    out.back().push_back(by_reads[k].second);
  }
  return out;
}

void StepPacker::add_map_pass(const Extent& domain, const std::vector<ValueId>& targets, int level, bool hardware) {
  Pass pass = map_pass(hardware);
  pass.domain = domain;
  close_over(pass, targets, level);
  if (hardware && options_.blocks) run_in_blocks(pass);
  if (pass.is_drawn() && stops(pass)) compute(pass);
  if (targets.size() == 1 && !within_limits(pass)) {
    // One value alone needs more than a fragment shader may have: compute shaders may have more.
    if (pass.is<FragmentPass>()) compute(pass);
    if (!within_limits(pass)) {
      spill(pass);
      close_over(pass, targets, level);
    }
  }
  add_pass(std::move(pass));
}

// A fragment shader computes one pixel. Where neighbours share what a loop reads, a compute shader is made that
// computes blocks of them.
void StepPacker::run_in_blocks(Pass& pass) {
  const target::Costs& costs = profile_.costs;
  const double share_to_beat = costs.compute_operations_per_ns / costs.fragment_operations_per_ns;
  if (!blocks_.choose(pass, share_to_beat)) return;
  const auto drawn = std::exchange(pass.of_kind, MapPass{});
  if (within_limits(pass))
    compute(pass);
  else
    pass.of_kind = drawn;
}

// By a compute shader.
void StepPacker::compute(Pass& pass) {
  pass.of_kind = MapPass{};
  for (const ValueId v : pass.writes) resource(v).leave_image();
}

// Whether its loops together have to stop and go on later, though each alone has not, or `looped_` knows of it.
bool StepPacker::stops(const Pass& pass) const { return needs_cut(trips_of(graph_, pass.ops), profile_); }

void StepPacker::make_passes() {
  int top = -1;
  for (OpId id : order_) top = std::max(top, level_[id.index]);
  std::vector<std::vector<OpId>> levels(static_cast<size_t>(top + 1));
  for (OpId id : order_)
    if (!is_memory(graph_.op(id))) levels[static_cast<size_t>(level_[id.index])].push_back(id);
  for (int level = 0; level <= top; ++level) {
    // Map groups by extent, in order of their first op.
    std::vector<std::pair<Extent, std::vector<OpId>>> groups;
    std::map<Extent, size_t> group_of;
    std::vector<OpId> single;
    for (OpId id : levels[static_cast<size_t>(level)]) {
      const Op& op = graph_.op(id);
      if (pass_kind(op) != PassKind::Map) {
        if (any_stored(op)) single.push_back(id);
        continue;
      }
      const Extent domain = domain_of(graph_, op);
      const auto [group, first] = group_of.try_emplace(domain, groups.size());
      if (!options_.fused || first)
        groups.push_back({domain, {id}});
      else
        groups[group->second].second.push_back(id);
    }
    for (const auto& [domain, members] : groups) add_map_passes(domain, members, level);
    for (OpId id : single) {
      const Op& op = graph_.op(id);
      Pass pass;
      switch (pass_kind(op)) {
        case PassKind::Map: break;  // those are in groups
        case PassKind::Reduce: pass.of_kind = ReducePass{}; break;
        case PassKind::Scatter: pass.of_kind = ScatterPass{}; break;
        case PassKind::Raster:
          if (drawn(op))
            pass.of_kind = DrawnRasterPass{};
          else
            pass.of_kind = RasterPass{};
          break;
      }
      pass.domain = domain_of(graph_, op);
      std::vector<ValueId> targets;
      for (ValueId v : op.results)
        if (out_.stored.count(v) != 0) targets.push_back(v);
      set_group(std::vector{id});
      close_over(pass, targets, level);
      if (pass.is<ScatterPass>() && !within_limits(pass)) {
        spill(pass);
        set_group(std::vector{id});
        close_over(pass, targets, level);
      }
      add_pass(std::move(pass));
    }
  }
}

// ---- merging ----

// One shader for both, where there can be one.
std::optional<Pass> StepPacker::merged(const Pass& from, const Pass& into) {
  if (from.ops.size() + into.ops.size() > kMaxMergedOps) return std::nullopt;
  Pass both = into;
  both.writes.insert(both.writes.end(), from.writes.begin(), from.writes.end());
  both.reads.clear();
  std::ranges::set_union(from.reads, into.reads, std::back_inserter(both.reads));
  std::erase_if(both.reads, [&](ValueId v) { return is_in(from.writes, v); });
  if (!within_limits(both)) return std::nullopt;
  for (OpId id : into.ops)
    for (ValueId v : uses_[id.index].elsewhere)
      if (is_in(from.writes, v)) return std::nullopt;

  std::vector<OpId> group = from.ops;
  group.insert(group.end(), into.ops.begin(), into.ops.end());
  set_group(group);
  int level = INT_MAX;
  for (ValueId v : both.writes) level = std::min(level, level_[graph_.value(v).op.index]);
  close_over(both, std::vector<ValueId>(both.writes), level);
  if (cone_.size > kMaxSize) return std::nullopt;
  // Nothing that it would write itself, and nothing new: the order of passes does not know of that.
  const bool sound = std::ranges::all_of(
      both.reads, [&](ValueId v) { return !is_in(both.writes, v) && (is_in(from.reads, v) || is_in(into.reads, v)); });
  if (!sound || !within_limits(both) || (both.is_drawn() && stops(both))) return std::nullopt;
  both.name = pass_name(both);
  return both;
}

// Levels are shortest ways; passes of one extent that no other stands between may wait longer and share a shader.
void StepPacker::merge_passes() {
  for (size_t begin = 0; begin < out_.passes.size(); begin += kMergeWindow)
    merge_passes(std::span(out_.passes).subspan(begin, std::min(kMergeWindow, out_.passes.size() - begin)));
  std::erase_if(out_.passes, [](const Pass& pass) { return pass.writes.empty(); });
}

// Of passes that stand beside each other: what two of them wait for in between is among them.
void StepPacker::merge_passes(std::span<Pass> passes) {
  PassOrder order(passes);
  std::map<std::tuple<Extent, bool, bool>, std::vector<size_t>> alike;
  for (size_t k = 0; k < passes.size(); ++k)
    if (passes[k].kind() == PassKind::Map)
      alike[{passes[k].domain, passes[k].is_drawn(), passes[k].steady}].push_back(k);
  for (const auto& [key, members] : alike) {
    for (size_t i = 0; i < members.size(); ++i) {
      Pass& into = passes[members[i]];
      for (size_t j = i > kMergeReach ? i - kMergeReach : 0; j < i; ++j) {
        Pass& from = passes[members[j]];
        if (from.writes.empty() || !order.may_merge(members[j], members[i])) continue;
        std::optional<Pass> both = merged(from, into);
        if (!both) continue;
        into = *std::move(both);
        from.writes.clear();
        order.merge(members[j], members[i]);
      }
    }
  }
}

}  // namespace dr::backend
