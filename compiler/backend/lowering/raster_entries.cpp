// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/raster_entries.h"

#include <algorithm>

#include "compiler/backend/analysis/raster_parts.h"

namespace dr::backend {

using ir::ValueId;

namespace {

// The place of the map that computes nothing but the bits of a raster's face, for others to read in this step.
std::optional<size_t> map_of_rows(const ir::Graph& graph, const StepSchedule& step, const std::set<ValueId>& kept,
                                  ValueId face) {
  for (size_t k = 0; k < step.passes.size(); ++k) {
    const Pass& pass = step.passes[k];
    if (pass.is<MapPass>() && pass.writes.size() == 1 && !kept.contains(pass.writes[0]) &&
        is_rows_of(graph, pass.writes[0], face))
      return k;
  }
  return std::nullopt;
}

// Gives the results of a raster a bit a pixel.
void keep_bits(const ir::Graph& graph, const std::set<ValueId>& kept, StepSchedule& step, Resource& bits, Pass& pass,
               std::set<uint32_t>& unused) {
  const ValueId face = graph.op(pass.ops.back()).results[0];
  bits.storage = Resource::Storage::Bits;
  bits.type = ir::kUint;
  bits.extent = bits_extent(pass.domain);
  const auto map = map_of_rows(graph, step, kept, face);
  if (!map) return;
  const ValueId rows = step.passes[*map].writes[0];
  pass.get<RasterPass>().rows = rows;
  pass.writes.push_back(rows);
  std::ranges::sort(pass.writes);
  unused.insert(step.stored.at(rows).index);
  step.stored.at(rows) = step.stored.at(face);
  step.passes[*map].ops.clear();
}

}  // namespace

void keep_entries(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule) {
  std::set<uint32_t> unused;
  for (StepSchedule& step : schedule.steps) {
    const std::set<ValueId> kept = read_afterwards(graph, step);
    for (Pass& pass : step.passes) {
      if (!pass.is<RasterPass>()) continue;
      const ir::Op& op = graph.op(pass.ops.back());
      const std::vector<ValueId>& results = op.results;
      if (results.size() == 1) continue;  // faces are listed: what the walk leaves is the result
      if (std::ranges::any_of(results, [&](ValueId v) { return kept.count(v) != 0; })) continue;
      const ResourceId id = step.stored.at(results[0]);
      Resource& entries = schedule.resources[id.index];
      if (profile.lanes_in_turn && profile.shader_int64 && is_asked_for_presence(graph, op)) {
        keep_bits(graph, kept, step, entries, pass, unused);
      } else {
        entries.name += "_entries";
        entries.storage = Resource::Storage::Entries;
        entries.type = ir::vec(2, ir::Scalar::Uint);
        entries.extent.l = entries.extent.l * ir::Dim(op.attrs.ints[0]);
      }
      for (size_t k = 1; k < results.size(); ++k) {
        unused.insert(step.stored.at(results[k]).index);
        step.stored.at(results[k]) = id;
      }
    }
    std::erase_if(step.passes, [](const Pass& pass) { return pass.ops.empty(); });
  }
  remove_resources(schedule, std::move(unused));
}

}  // namespace dr::backend
