// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/set_up_in_raster.h"

#include <algorithm>
#include <utility>

#include "compiler/backend/analysis/raster_parts.h"
#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/schedule/limits.h"
#include "compiler/backend/schedule/trips.h"

namespace dr::backend {

using ir::ValueId;

namespace {

// Raster's own loops take less than the rest of the trips that an invocation has.
constexpr int64_t kShared = 2;

bool meet(const std::vector<ValueId>& a, const std::vector<ValueId>& b) {
  return std::ranges::any_of(a, [&](ValueId v) { return std::ranges::find(b, v) != b.end(); });
}

// Whether `later` must stay behind `pass`, or `pass` before it.
bool depends(const StepSchedule& step, const Pass& later, const Pass& pass) {
  if (meet(later.reads, pass.writes)) return true;
  return std::ranges::any_of(later.writes, [&](ValueId written) {
    return std::ranges::any_of(pass.reads, [&](ValueId v) { return step.stored.at(v) == step.stored.at(written); });
  });
}

bool one_shader(const StepSchedule& step, const Schedule& schedule, const target::Profile& profile, const Pass& pass,
                const Pass& raster) {
  const std::vector<uint32_t> written = resources_of(step, pass.writes);
  std::vector<uint32_t> read = resources_of(step, pass.reads);
  for (const uint32_t r : resources_of(step, raster.reads)) read.push_back(r);
  std::erase_if(read, [&](uint32_t r) { return std::ranges::find(written, r) != written.end(); });
  constexpr size_t kOwn = 2;  // entries and lists
  return fits(profile, bindings_of(schedule.resources, std::move(read),
                                   std::set<uint32_t>(written.begin(), written.end()).size() + kOwn));
}

// Whether another raster reads what a pass computes of its faces, too. A GPU draws both at once if neither waits for
// the other's first dispatch.
bool draws_beside(const StepSchedule& step, const target::Profile& profile, const Pass& pass, const Pass& raster) {
  return profile.is_gpu() && std::ranges::any_of(step.passes, [&](const Pass& other) {
           return &other != &raster && other.is<RasterPass>() && meet(other.reads, pass.writes);
         });
}

// Components that `ops` load: of what they read at other places, and of `stored` values.
int loaded_by(const ir::Graph& graph, std::span<const ir::OpId> ops, const std::set<ValueId>& stored) {
  std::set<ValueId> here;
  int loaded = 0;
  for (ir::OpId id : ops) {
    const ir::Op& op = graph.op(id);
    const Uses uses = uses_of(graph, op);
    if (!uses.elsewhere.empty())
      for (ValueId v : op.results) loaded += graph.value(v).type.components();
    for (ValueId v : uses.at_element)
      if (stored.contains(v) && here.insert(v).second) loaded += graph.value(v).type.components();
  }
  return loaded;
}

// Whether ops read what a pass writes over, as a leaf that it moves: who computes them behind it finds the new value.
bool reads_what_changes(const ir::Graph& graph, const StepSchedule& step, const Pass& pass,
                        std::span<const ir::OpId> ops) {
  const auto changes = [&](ValueId v) {
    const auto at = step.stored.find(v);
    return at != step.stored.end() && std::ranges::any_of(pass.writes, [&](ValueId written) {
             return written != v && step.stored.at(written) == at->second;
           });
  };
  return std::ranges::any_of(ops, [&](ir::OpId id) {
    const Uses uses = uses_of(graph, graph.op(id));
    return std::ranges::any_of(uses.elsewhere, changes) || std::ranges::any_of(uses.at_element, changes);
  });
}

// Whether those who walk listed faces compute `values` of their record again, else stored for them: where that loads no
// more components than to store the values and to load them. What it computes is cheap beside either, a few hundred
// operations, but for loops on a processor, which takes them again for one lane of a face's team after the other. There
// each team also loads for all its lanes, and a store is for the face alone.
bool cheap_again(const ir::Graph& graph, const target::Profile& profile, const StepSchedule& step, const Pass& raster,
                 const Pass& setup, KeptPixels kept, const std::set<ValueId>& record, const std::set<ValueId>& values) {
  std::set<ValueId> stored;
  for (const Pass* pass : {&setup, &raster})
    for (const auto* some : {&pass->reads, &pass->writes}) stored.insert(some->begin(), some->end());
  for (ValueId v : record) stored.erase(v);  // is loaded anyway
  const std::vector<ir::OpId> ops = set_up_again(graph, raster, &setup, kept, values);
  if (reads_what_changes(graph, step, setup, ops)) return false;
  if (profile.lanes_in_turn && trips_of(graph, ops).loops > 0) return false;
  int components = 0;
  for (ValueId v : values) components += graph.value(v).type.components();
  const int loaded =
      loaded_by(graph, ops, stored) - loaded_by(graph, set_up_again(graph, raster, &setup, kept), stored);
  return loaded <= (profile.lanes_in_turn ? components : 2 * components);
}

// Takes partial results of a pass out of memory.
void forget(StepSchedule& step, Pass& setup, Pass& raster, const std::set<ValueId>& values,
            std::set<uint32_t>& unused) {
  for (ValueId v : values) {
    std::erase(setup.get<MapPass>().partial, v);
    std::erase(setup.writes, v);
    std::erase(raster.reads, v);
    unused.insert(step.stored.at(v).index);
    step.stored.erase(v);
  }
}

// Leaves of the partial results what walks of listed faces need and do not compute again: all of it, or one after the
// other, the last ones first, which are made of others.
void forget_cheap(const ir::Graph& graph, const target::Profile& profile, StepSchedule& step, Pass& setup, Pass& raster,
                  KeptPixels kept, std::set<uint32_t>& unused) {
  const ir::Op& op = graph.op(raster.ops.back());
  const std::set<ValueId> record = walked_record(graph, op, has_depths(graph, op, kept));
  std::set<ValueId> needless, needed;
  for (const ValueId v : setup.get<MapPass>().partial) (record.contains(v) ? needed : needless).insert(v);
  forget(step, setup, raster, needless, unused);
  if (cheap_again(graph, profile, step, raster, setup, kept, record, needed))
    return forget(step, setup, raster, needed, unused);
  for (const ValueId v : std::vector(needed.rbegin(), needed.rend()))
    if (cheap_again(graph, profile, step, raster, setup, kept, record, {v})) forget(step, setup, raster, {v}, unused);
}

}  // namespace

void set_up_in_raster(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule) {
  if (!profile.shader_int64 || !profile.shader_buffer_int64_atomics) return;
  std::set<uint32_t> unused;
  for (StepSchedule& step : schedule.steps) {
    const std::set<ValueId> kept = read_afterwards(graph, step);
    const auto is_taken = [&](PassId map) {
      return !listed_for(step, map).empty() || set_up_for(step, map) != nullptr;
    };
    for (size_t k = 0; k < step.passes.size(); ++k) {
      Pass& raster = step.passes[k];
      if (!raster.is<RasterPass>()) continue;
      const ir::Op& op = graph.op(raster.ops.back());
      const ir::Extent faces{op.attrs.dims[3], 1, op.attrs.dims[2]};
      // A captured value must not be taken for that of a face.
      if (faces == raster.domain) continue;
      for (size_t j = k; j-- > 0 && raster.setup() == nullptr;) {
        const Pass& pass = step.passes[j];
        const bool fits = pass.is<MapPass>() && pass.domain == faces && pass.steady == raster.steady &&
                          meet(raster.reads, pass.writes) && !is_taken(pass_id(j)) &&
                          !draws_beside(step, profile, pass, raster) &&
                          one_shader(step, schedule, profile, pass, raster) &&
                          !may_pass_limit(trips_of(graph, pass.ops), profile, kShared);
        if (!fits) continue;
        const bool waits = std::any_of(step.passes.begin() + static_cast<std::ptrdiff_t>(j) + 1,
                                       step.passes.begin() + static_cast<std::ptrdiff_t>(k),
                                       [&](const Pass& between) { return depends(step, between, pass); });
        if (waits) continue;
        raster.get<RasterPass>().setup = FaceSetup{pass_id(j)};
        Pass& setup = step.passes[j];
        for (ValueId v : setup.writes) {
          const bool others = std::ranges::any_of(step.passes, [&](const Pass& other) {
            return &other != &raster && std::ranges::find(other.reads, v) != other.reads.end();
          });
          if (!others && kept.count(v) == 0) setup.get<MapPass>().partial.push_back(v);
        }
        forget_cheap(graph, profile, step, setup, raster, kept_pixels(schedule, step, op), unused);
      }
    }
  }
  remove_resources(schedule, std::move(unused));
}

}  // namespace dr::backend
