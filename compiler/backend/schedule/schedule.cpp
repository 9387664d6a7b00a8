// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/schedule/schedule.h"

#include <algorithm>
#include <set>

#include "compiler/backend/analysis/read_part.h"
#include "compiler/backend/analysis/uses.h"
#include "compiler/ir/pins.h"
#include "compiler/ops/op.h"

namespace dr::backend {

using ir::Graph;
using ir::Op;
using ir::OpId;
using ir::ValueId;

bool is_packed(const Graph& graph, ValueId value) {
  const ir::ValueInfo& info = graph.value(value);
  return info.op.valid() && graph.op(info.op).kind == ir::OpKind::Half && info.type.components() > 1;
}

std::set<ValueId> read_afterwards(const Graph& graph, const StepSchedule& step) {
  std::set<ValueId> out;
  for (const auto& [name, v] : step.outputs) out.insert(v);
  for (const auto& [leaf, v] : step.updates) out.insert(v);
  for (const auto& [v, name] : ir::pin_names(graph)) out.insert(v);
  return out;
}

std::vector<ValueId> stage_inputs(const StepSchedule& step, size_t pass) {
  std::set<ValueId> written;
  for (size_t k = pass; k-- > 0 && step.passes[k].stage == step.passes[pass].stage;)
    written.insert(step.passes[k].writes.begin(), step.passes[k].writes.end());
  std::vector<ValueId> out;
  for (ValueId v : step.passes[pass].reads)
    if (written.count(v) != 0) out.push_back(v);
  return out;
}

std::vector<const Pass*> listed_for(const StepSchedule& step, PassId map) {
  std::vector<const Pass*> out;
  for (const Pass& pass : step.passes)
    if (pass.lister() == map) out.push_back(&pass);
  return out;
}

const Pass* set_up_for(const StepSchedule& step, PassId map) {
  const auto found = std::ranges::find_if(
      step.passes, [&](const Pass& pass) { return pass.setup() != nullptr && pass.setup()->pass == map; });
  return found == step.passes.end() ? nullptr : &*found;
}

RasterPart raster_part(const ir::Graph& graph, ValueId value) {
  const ir::Op& op = graph.op(graph.value(value).op);
  const auto k = static_cast<size_t>(std::ranges::find(op.results, value) - op.results.begin());
  const size_t each = ir::results_a_rank(op.attrs);
  return {k / each, static_cast<ir::RasterResult>(k % each)};
}

void remove_resources(Schedule& schedule, std::set<uint32_t> unused) {
  for (const StepSchedule& step : schedule.steps)
    for (const auto& [value, id] : step.stored) unused.erase(id.index);
  if (unused.empty()) return;
  std::vector<uint32_t> now(schedule.resources.size());
  std::vector<Resource> resources;
  for (uint32_t k = 0; k < now.size(); ++k) {
    now[k] = static_cast<uint32_t>(resources.size());
    if (unused.count(k) == 0) resources.push_back(std::move(schedule.resources[k]));
  }
  schedule.resources = std::move(resources);
  for (StepSchedule& step : schedule.steps)
    for (auto& [value, id] : step.stored) id.index = now[id.index];
}

namespace {

bool has_scatter(const Op& op) {
  return std::find(op.attrs.yields.begin(), op.attrs.yields.end(), ir::Yield::Scatter) != op.attrs.yields.end();
}

}  // namespace

PassKind pass_kind(const Op& op) {
  const PassKind kind = ops::info(op.kind).runs_as.value_or(PassKind::Map);
  return kind == PassKind::Map && has_scatter(op) ? PassKind::Scatter : kind;
}

// Elements over which an op's shader runs.
ir::Extent domain_of(const Graph& graph, const Op& op) {
  switch (pass_kind(op)) {
    case PassKind::Raster: return {op.attrs.dims[0], op.attrs.dims[1], op.attrs.dims[2]};
    case PassKind::Scatter:
      if (!op.regions.empty()) return {op.attrs.dims[0], op.attrs.dims[1], op.attrs.dims[2]};
      return *ir::broadcast(graph.value(op.operands[0]).extent, graph.value(op.operands[1]).extent);
    case PassKind::Reduce: return graph.value(op.operands[0]).extent;
    case PassKind::Map: break;
  }
  return graph.value(op.results[0]).extent;
}

std::optional<int64_t> shared_bytes(const ir::Graph& graph, const Block& block) {
  ChangingAxes changing(graph);
  int64_t bytes = 0;
  for (const ir::OpId id : block.together->gathers) {
    const ir::Op& op = graph.op(id);
    const auto part = read_part(graph, op, block.together->loop, block.box(), block.together->trips, changing);
    if (!part) return std::nullopt;
    bytes += 4 * part->elements() * graph.value(op.results[0]).type.components();
  }
  return bytes;
}

}  // namespace dr::backend
