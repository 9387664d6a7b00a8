// SPDX-License-Identifier: Apache-2.0
// The schedule's text form.
#include <algorithm>
#include <set>

#include "compiler/backend/schedule/schedule.h"
#include "compiler/ops/op.h"

namespace dr::backend {

using ir::Graph;
using ir::OpId;
using ir::ValueId;

std::string print(const Graph& graph, const Schedule& schedule) {
  std::string out;
  auto resource_text = [&](const StepSchedule& step, ValueId v) {
    const Resource& r = schedule.resources[step.stored.at(v).index];
    if (!r.entries) return r.name;
    const RasterPart part = raster_part(graph, v);
    return r.name + (part.tag ? ".tag" : ".face") + std::to_string(part.rank);
  };
  auto value_text = [&](const StepSchedule& step, ValueId v) {
    return step.stored.count(v) != 0 ? resource_text(step, v)
                                     : "a " + std::string(ir::op_name(graph.op(graph.value(v).op).kind));
  };
  for (const StepSchedule& step : schedule.steps) {
    out += "step " + step.name + " {\n";
    std::set<uint32_t> declared;
    for (const auto& [v, id] : step.stored)
      if (declared.insert(id.index).second) {
        const Resource& r = schedule.resources[id.index];
        out += std::string("  ") +
               (r.leaf >= 0                             ? "leaf"
                : r.entries                             ? "entries"
                : r.sums                                ? "sums"
                : r.half                                ? "half buffer"
                : r.storage == Resource::Storage::Image ? "image"
                : r.storage == Resource::Storage::Tile  ? "tile"
                                                        : "buffer") +
               " " + r.name + " : " + r.type.str() + r.extent.str() + "\n";
      }
    for (size_t k = 0; k < step.passes.size(); ++k) {
      const Pass& pass = step.passes[k];
      if (k == 0 || step.passes[k - 1].stage != pass.stage) out += "  stage " + std::to_string(pass.stage) + "\n";
      out += "  pass " + pass.name + " " + kind_name(pass) + " " + (pass.domain.is_unit() ? "[1]" : pass.domain.str()) +
             "\n";
      out += "    reads";
      const std::vector<ValueId> inputs = stage_inputs(step, k);
      for (ValueId v : pass.reads)
        out += (std::find(inputs.begin(), inputs.end(), v) != inputs.end() ? " input:" : " ") + resource_text(step, v);
      out += "\n    ops";
      for (OpId id : pass.ops) out += " " + std::string(ir::op_name(graph.op(id).kind));
      out += "\n    writes";
      for (ValueId v : pass.writes) out += " " + resource_text(step, v);
      out += "\n";
      if (!pass.partial.empty()) out += "    partial";
      for (const ValueId v : pass.partial) out += " " + resource_text(step, v);
      if (!pass.partial.empty()) out += "\n";
      for (const ScatterSum& sum : pass.sums)
        if (sum.terms.size() > 1)
          out += "    sum " + resource_text(step, sum.value) + " of " + std::to_string(sum.terms.size()) + "\n";
      if (!pass.active.empty()) out += "    active";
      for (size_t c = 0; c < pass.active.size(); ++c)
        for (size_t i = 0; i < pass.active[c].size(); ++i)
          out += (i > 0 ? " and " : c > 0 ? ", or " : " ") + value_text(step, pass.active[c][i]);
      if (pass.listed_by >= 0)
        out += std::string(pass.joins_lister ? ", joins " : ", listed by ") +
               step.passes[static_cast<size_t>(pass.listed_by)].name;
      if (!pass.active.empty()) out += "\n";
      if (pass.set_up_by >= 0)
        out += "    set up by " + step.passes[static_cast<size_t>(pass.set_up_by)].name +
               (pass.sets_up_again ? ", twice where listed\n" : "\n");
      if (pass.keeps_terms) out += "    keeps terms\n";
      if (pass.join_lanes) out += "    join lanes\n";
      if (pass.relist) out += "    relist\n";
      if (!pass.no_rows.empty()) out += "    no rows: " + pass.no_rows + "\n";
      if (pass.scatter == ScatterLowering::Rows && pass.rows.sorted()) {
        out += "    rows sorted by";
        for (const ScatterLeaf& place : pass.rows.places) out += " " + value_text(step, place.index);
        out += " of " + pass.rows.targets.str() + "\n";
      } else if (pass.scatter == ScatterLowering::Rows) {
        out += "    rows " + schedule.resources[pass.rows.leaf].name + "[";
        for (size_t c = 0; c < pass.rows.columns.size(); ++c)
          out += (c ? ", " : "") + std::to_string(pass.rows.columns[c]);
        out += "] of " + pass.rows.targets.str() + "\n";
      }
    }
    for (const auto& [name, v] : step.outputs) out += "  output " + name + " = " + resource_text(step, v) + "\n";
    for (const auto& [leaf, v] : step.updates)
      out += "  update " + graph.leaves[leaf].name +
             (step.stored.at(v).index == leaf ? " in place" : " <- " + resource_text(step, v)) + "\n";
    out += "}\n";
  }
  return out;
}

}  // namespace dr::backend
