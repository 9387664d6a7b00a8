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
using ir::OpKind;
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

RasterPart raster_part(const ir::Graph& graph, ValueId value) {
  const std::vector<ValueId>& results = graph.op(graph.value(value).op).results;
  const auto k = static_cast<size_t>(std::ranges::find(results, value) - results.begin());
  return {k / 2, k % 2 == 1};
}

void remove_resources(Schedule& schedule, const std::set<uint32_t>& unused) {
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

Pass::Kind pass_kind(const Op& op) {
  switch (ops::info(op.kind).runs_as.value_or(ops::RunsAs::Map)) {
    case ops::RunsAs::Reduce: return Pass::Kind::Reduce;
    case ops::RunsAs::Scatter: return Pass::Kind::Scatter;
    case ops::RunsAs::Raster: return Pass::Kind::Raster;
    case ops::RunsAs::Map: break;
  }
  return has_scatter(op) ? Pass::Kind::Scatter : Pass::Kind::Map;
}

// Elements over which an op's shader runs.
ir::Extent domain_of(const Graph& graph, const Op& op) {
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

const char* kind_name(const Pass& pass) {
  switch (pass.kind) {
    case Pass::Kind::Map: return pass.hardware ? "fragment" : "compute";
    case Pass::Kind::Reduce: return "reduce";
    case Pass::Kind::Scatter:
      return pass.scatter == ScatterLowering::Rows     ? "scatter rows"
             : pass.scatter == ScatterLowering::Atomic ? "scatter atomic"
                                                       : "scatter exact";
    case Pass::Kind::Raster: return pass.hardware ? "raster hardware" : "raster compute";
  }
  return "";
}

std::optional<int64_t> shared_bytes(const ir::Graph& graph, const Block& block) {
  ChangingAxes changing(graph);
  int64_t bytes = 0;
  for (const ir::OpId id : block.gathers) {
    const ir::Op& op = graph.op(id);
    const auto part = read_part(graph, op, block.loop, block.box(), block.trips, changing);
    if (!part) return std::nullopt;
    bytes += 4 * part->elements() * graph.value(op.results[0]).type.components();
  }
  return bytes;
}

}  // namespace dr::backend
