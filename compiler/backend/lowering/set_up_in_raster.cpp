// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/set_up_in_raster.h"

#include <algorithm>
#include <utility>

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

// Whether to load what a face is set up from takes no more components than to store the partial results for listed
// faces and to load those again. What it computes is cheap beside either, a few hundred operations, but for loops on a
// processor, which takes them again for one lane of a face's team after the other. There each team also loads for all
// its lanes, and a store is for the face alone.
bool cheap_again(const ir::Graph& graph, const target::Profile& profile, const Pass& setup) {
  if (profile.lanes_in_turn && trips_of(graph, setup.ops).loops > 0) return false;
  std::set<ValueId> here;
  int loaded = 0, kept = 0;
  for (ir::OpId id : setup.ops) {
    const ir::Op& op = graph.op(id);
    const Uses uses = uses_of(graph, op);
    if (!uses.elsewhere.empty())
      for (ValueId v : op.results) loaded += graph.value(v).type.components();
    for (ValueId v : uses.at_element)
      if (std::ranges::find(setup.reads, v) != setup.reads.end() && here.insert(v).second)
        loaded += graph.value(v).type.components();
  }
  for (ValueId v : setup.get<MapPass>().partial) kept += graph.value(v).type.components();
  return loaded <= (profile.lanes_in_turn ? kept : 2 * kept);
}

// Takes the partial results of a pass out of memory.
void forget_partial(StepSchedule& step, Pass& setup, Pass& raster, std::set<uint32_t>& unused) {
  for (ValueId v : std::exchange(setup.get<MapPass>().partial, {})) {
    std::erase(setup.writes, v);
    std::erase(raster.reads, v);
    unused.insert(step.stored.at(v).index);
    step.stored.erase(v);
  }
  raster.get<RasterPass>().setup->again = true;
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
        if (cheap_again(graph, profile, setup)) forget_partial(step, setup, raster, unused);
      }
    }
  }
  remove_resources(schedule, std::move(unused));
}

}  // namespace dr::backend
