// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/pack/join_captures.h"

#include <algorithm>
#include <map>
#include <tuple>

#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/schedule/limits.h"
#include "compiler/ops/emit.h"

namespace dr::backend {

using ir::Graph;
using ir::Op;
using ir::OpId;
using ir::RegionId;
using ir::ValueId;

namespace {

constexpr size_t kMost = 4;  // components of a vector, columns of a matrix

using Group = std::vector<ValueId>;
using Groups = std::vector<Group>;

bool is_crowded(const Schedule& schedule, const StepSchedule& step, const Pass& pass, const target::Profile& profile) {
  if (pass.kind() == PassKind::Raster || pass.kind() == PassKind::Reduce) return false;
  const std::vector<uint32_t> written = resources_of(step, pass.writes);
  Bindings all = bindings_of(schedule.resources, resources_of(step, pass.reads),
                             std::set<uint32_t>(written.begin(), written.end()).size(), pass.is_drawn());
  if (pass.is<ScatterPass>()) all.more += kScatterBuffers;
  return !fits(profile, all);
}

// Values of the root region that the op's regions take at their element, and there alone. Entries of a raster have one
// buffer already.
std::set<ValueId> captured(const Graph& graph, const Schedule& schedule, const StepSchedule& step, const Op& op) {
  std::set<ValueId> out;
  for (const RegionId region : op.regions)
    for (const ValueId v : ir::captures(graph, region)) out.insert(v);
  for (const ValueId v : uses_of(graph, op).elsewhere) out.erase(v);
  std::erase_if(out, [&](ValueId v) {
    const ir::ValueInfo& info = graph.value(v);
    const auto stored = step.stored.find(v);
    if (stored != step.stored.end() && schedule.resources[stored->second.index].is(Resource::Storage::Entries))
      return true;
    return is_inline(graph.op(info.op)) || info.type.is_matrix() || (!info.type.is_float() && !info.type.is_scalar());
  });
  return out;
}

ir::Type joined_type(const ir::Type& part, size_t count) {
  const auto n = static_cast<uint8_t>(count);
  return part.is_scalar() ? ir::Type{part.scalar, n, 1} : ir::Type{part.scalar, part.rows, n};
}

class Joiner : Rewriter {
 public:
  Joiner(const Graph& from, std::map<OpId, Groups> groups) : Rewriter(from), groups_(std::move(groups)) {}

  Joined run() {
    for (const OpId id : from_.region(from_.root()).ops) {
      const auto found = groups_.find(id);
      found != groups_.end() ? copy_joined(id, found->second) : copy(id);
    }
    return finish();
  }

 private:
  // One value for all of a group, stored whoever uses it.
  ValueId join(const Group& group) {
    const auto [found, first] = values_.try_emplace(group);
    if (first) {
      std::vector<ValueId> parts;
      for (const ValueId v : group) parts.push_back(map_[v]);
      const ir::Type type = joined_type(from_.value(group[0]).type, group.size());
      found->second = ops::emit(to_, ir::OpKind::Pin, {ops::compose(to_, std::move(parts), type)});
    }
    return found->second;
  }

  void copy_joined(OpId id, const Groups& groups) {
    const Op& op = from_.op(id);
    std::map<ValueId, std::pair<ValueId, int>> place;  // of a captured value: what it is joined in, and where
    for (const Group& group : groups)
      for (size_t k = 0; k < group.size(); ++k) place[group[k]] = {join(group), static_cast<int>(k)};
    to_.set_span(op.span);
    std::vector<RegionId> regions;
    for (const RegionId old : op.regions) regions.push_back(copy_region(old, place));
    std::vector<ValueId> operands;
    for (const ValueId v : op.operands) operands.push_back(map_[v]);
    std::vector<ir::ResultType> results;
    for (const ValueId v : op.results) results.push_back({from_.value(v).type, from_.value(v).extent, false});
    const OpId now = to_.add(op.kind, operands, results, op.attrs, std::move(regions), op.span);
    for (size_t k = 0; k < op.results.size(); ++k) {
      const ValueId result = to_.graph().op(now).results[k];
      map_.set(op.results[k], result);
      to_.set_name(result, from_.value(op.results[k]).name);
    }
    to_.set_span({});
    match(id, now);
  }

  RegionId copy_region(RegionId old, const std::map<ValueId, std::pair<ValueId, int>>& place) {
    const ir::Region& region = from_.region(old);
    std::vector<ir::ResultType> params;
    for (const ValueId v : region.params) params.push_back({from_.value(v).type, from_.value(v).extent, false});
    const RegionId now = to_.begin_region(params);
    for (size_t k = 0; k < params.size(); ++k) {
      const ValueId param = to_.graph().region(now).params[k];
      map_.set(region.params[k], param);
      to_.set_name(param, from_.value(region.params[k]).name);
    }
    std::vector<std::pair<ValueId, ValueId>> outside;
    for (const ValueId v : ir::captures(from_, old))
      if (const auto found = place.find(v); found != place.end()) {
        outside.emplace_back(v, map_[v]);
        map_.set(v, ops::extract(to_, found->second.first, found->second.second));
      }
    for (const OpId id : region.ops) ir::copy_op(from_, id, to_, map_);
    std::vector<ValueId> yields;
    for (const ValueId v : region.yields) yields.push_back(map_[v]);
    to_.end_region(std::move(yields));
    for (const auto& [v, before] : outside) map_.set(v, before);
    return now;
  }

  const std::map<OpId, Groups> groups_;
  std::map<Group, ValueId> values_;
};

}  // namespace

std::optional<Joined> join_captures(const Graph& graph, const Schedule& schedule, const target::Profile& profile) {
  std::map<OpId, Groups> groups;
  for (size_t s = 0; s < schedule.steps.size(); ++s) {
    const StepSchedule& step = schedule.steps[s];
    for (const Pass& pass : step.passes) {
      if (!is_crowded(schedule, step, pass, profile)) continue;
      // What the step leaves as it is stays apart from what changes: it is made once.
      const std::vector<bool> steady = steady_ops(graph, graph.steps[s]);
      for (const OpId id : pass.ops) {
        if (groups.count(id) != 0) continue;
        using Key = std::tuple<std::string, ir::Extent, bool>;
        std::map<Key, Group> alike;
        for (const ValueId v : captured(graph, schedule, step, graph.op(id))) {
          const ir::ValueInfo& info = graph.value(v);
          alike[{info.type.str(), info.extent, steady[info.op.index]}].push_back(v);
        }
        Groups of_op;
        for (const auto& [key, values] : alike)
          for (size_t k = 0; k + 1 < values.size(); k += kMost) {
            const auto begin = values.begin() + static_cast<std::ptrdiff_t>(k);
            of_op.emplace_back(begin, begin + static_cast<std::ptrdiff_t>(std::min(kMost, values.size() - k)));
          }
        if (!of_op.empty()) groups.emplace(id, std::move(of_op));
      }
    }
  }
  if (groups.empty()) return std::nullopt;
  return Joiner(graph, std::move(groups)).run();
}

}  // namespace dr::backend
