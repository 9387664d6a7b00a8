// SPDX-License-Identifier: Apache-2.0
// The schedule's text form and its checker, which knows nothing of how packing decided.
#include "compiler/backend/schedule/schedule.h"

#include <algorithm>
#include <set>

#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/schedule/trips.h"
#include "compiler/ir/pins.h"
#include "compiler/ops/op.h"

namespace dr::backend {

using ir::Graph;
using ir::Op;
using ir::OpId;
using ir::OpKind;
using ir::ValueId;

namespace {

void captured_operands(const Graph& graph, const Op& op, std::set<ValueId>& out) {
  for (ValueId v : op.operands)
    if (graph.value(v).region == graph.root()) out.insert(v);
  for (ir::RegionId region : op.regions) {
    for (OpId id : graph.region(region).ops) captured_operands(graph, graph.op(id), out);
    for (ValueId v : graph.region(region).yields)
      if (graph.value(v).region == graph.root()) out.insert(v);
  }
}

}  // namespace

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

std::vector<std::string> check_schedule(const Graph& graph, const Schedule& schedule, const target::Profile& profile) {
  std::vector<std::string> problems;
  for (const StepSchedule& step : schedule.steps) {
    std::set<ValueId> ready;
    std::set<uint32_t> overwritten;  // leaves that hold their new value already
    const std::vector<bool> steady = steady_ops(graph, graph.steps[*graph.step_index(step.name)]);
    auto is_ready = [&](ValueId v) {
      if (!is_memory(graph.op(graph.value(v).op))) return ready.count(v) != 0;
      const auto it = step.stored.find(v);
      return it == step.stored.end() || overwritten.count(it->second.index) == 0;
    };
    auto is_tile = [&](ValueId v) {
      const auto it = step.stored.find(v);
      return it != step.stored.end() && schedule.resources[it->second.index].storage == Resource::Storage::Tile;
    };
    for (size_t k = 0; k < step.passes.size(); ++k) {
      const Pass& pass = step.passes[k];
      auto report = [&](const std::string& what) {
        problems.push_back("step " + step.name + ", pass " + pass.name + ": " + what);
      };
      const std::vector<ValueId> inputs = stage_inputs(step, k);
      std::set<ValueId> here;
      for (ValueId v : pass.reads) {
        if (step.stored.count(v) == 0)
          report("reads a value that is not stored");
        else if (!is_ready(v))
          report("reads '" + schedule.resources[step.stored.at(v).index].name + "' before it is written");
        else if (is_tile(v) && std::find(inputs.begin(), inputs.end(), v) == inputs.end())
          report("reads '" + schedule.resources[step.stored.at(v).index].name + "', which its stage has not written");
        here.insert(v);
      }
      if (pass.set_up_by >= 0) {
        // It runs no earlier than here.
        const Pass& setup = step.passes[static_cast<size_t>(pass.set_up_by)];
        for (size_t j = static_cast<size_t>(pass.set_up_by) + 1; j < k; ++j)
          for (ValueId v : step.passes[j].reads)
            if (std::find(setup.writes.begin(), setup.writes.end(), v) != setup.writes.end())
              report("sets up late what '" + step.passes[j].name + "' reads");
        if (setup.steady != pass.steady) report("sets up what runs at other times");
        if (pass.sets_up_again)
          for (OpId id : setup.ops)
            for (ValueId v : graph.op(id).results) here.insert(v);
      }
      std::set<ValueId> elsewhere;
      for (OpId id : pass.ops) {
        const Op& op = graph.op(id);
        for (ValueId v : uses_of(graph, op).elsewhere) elsewhere.insert(v);
        std::set<ValueId> needs;
        captured_operands(graph, op, needs);
        for (ValueId v : needs)
          if (here.count(v) == 0 && !(op.kind == OpKind::Raster && is_inline(graph.op(graph.value(v).op))))
            report("op '" + std::string(ir::op_name(op.kind)) + "' lacks an operand");
        for (ValueId v : op.results) here.insert(v);
      }
      for (const ScatterLeaf& place : pass.rows.places) {
        std::vector<ValueId> sorted_by{place.index};
        for (const ScatterLeaf::Branch& branch : place.path)
          if (branch.in_table) sorted_by.push_back(graph.op(branch.op).operands[0]);
        for (ValueId v : root_values_at(graph, place, sorted_by))
          if (steady[graph.value(v).op.index]) report("sorts by what its step changes");
      }
      const bool fragment = pass.kind == Pass::Kind::Map && pass.hardware;
      if (pass.hardware && may_pass_limit(trips_of(graph, pass.ops), profile))
        report("loops in a fragment shader that may take more than the device's " + std::to_string(profile.loop_trips) +
               " trips");
      if (k > 0 && step.passes[k - 1].stage == pass.stage) {
        const Pass& before = step.passes[k - 1];
        const bool before_fragment = before.kind == Pass::Kind::Map && before.hardware;
        if (fragment != before_fragment || (fragment ? before.domain != pass.domain : pass.hardware || before.hardware))
          report("is of another kind or extent than the rest of its stage");
      }
      for (ValueId v : inputs)
        if (!fragment)
          report("needs another pass of its stage");
        else if (elsewhere.count(v) != 0 || graph.value(v).extent != pass.domain)
          report("reads a value of its stage at other places");
      if (inputs.size() > profile.max_per_stage_descriptor_input_attachments)
        report(std::to_string(inputs.size()) + " input attachments, device allows " +
               std::to_string(profile.max_per_stage_descriptor_input_attachments));
      std::set<uint32_t> buffers, images;
      for (ValueId v : pass.reads) {
        auto it = step.stored.find(v);
        if (it == step.stored.end()) continue;
        (schedule.resources[it->second.index].storage == Resource::Storage::Buffer ? buffers : images)
            .insert(it->second.index);
      }
      const size_t sampled = images.size() + (profile.lanes_in_turn ? buffers.size() : 0);
      uint32_t colors = 0;
      for (ValueId v : pass.writes) {
        if (here.count(v) == 0) report("stores a value that it does not compute");
        auto it = step.stored.find(v);
        if (it == step.stored.end()) {
          report("stores a value without a resource");
          continue;
        }
        if (const Resource& to = schedule.resources[it->second.index]; to.leaf >= 0) {
          overwritten.insert(it->second.index);
          for (ValueId old : elsewhere)
            if (step.stored.count(old) != 0 && step.stored.at(old) == it->second)
              report("overwrites leaf '" + to.name + "' while it reads it at other places");
          if (pass.kind != Pass::Kind::Map || pass.domain != to.extent)
            report("overwrites leaf '" + to.name + "' from other places");
        }
        if (schedule.resources[it->second.index].storage == Resource::Storage::Buffer)
          buffers.insert(it->second.index);
        else
          ++colors;
        if (!ready.insert(v).second && pass.kind != Pass::Kind::Map) report("stores a value twice");
      }
      if (pass.kind == Pass::Kind::Raster) continue;  // its draws and dispatches bind one result at a time
      if (buffers.size() > profile.max_per_stage_descriptor_storage_buffers)
        report(std::to_string(buffers.size()) + " storage buffers, device allows " +
               std::to_string(profile.max_per_stage_descriptor_storage_buffers));
      if (sampled > profile.max_per_stage_descriptor_sampled_images)
        report(std::to_string(sampled) + " sampled images, device allows " +
               std::to_string(profile.max_per_stage_descriptor_sampled_images));
      if (colors > profile.max_color_attachments)
        report(std::to_string(colors) + " colour attachments, device allows " +
               std::to_string(profile.max_color_attachments));
      if (buffers.size() + images.size() + colors > profile.max_per_stage_resources)
        report(std::to_string(buffers.size() + images.size() + colors) + " resources, device allows " +
               std::to_string(profile.max_per_stage_resources));
      if (pass.hardware && buffers.size() + colors > profile.max_fragment_combined_output_resources)
        report(std::to_string(buffers.size() + colors) + " storage buffers and colour attachments, device allows " +
               std::to_string(profile.max_fragment_combined_output_resources) + " in a fragment shader");
    }
    for (const auto& [name, v] : step.outputs)
      if (step.stored.count(v) == 0 || !is_ready(v) || is_tile(v))
        problems.push_back("step " + step.name + ": output '" + name + "' is never stored");
    for (const auto& [leaf, v] : step.updates)
      if (step.stored.count(v) == 0 || !is_ready(v) || is_tile(v))
        problems.push_back("step " + step.name + ": the update of '" + graph.leaves[leaf].name + "' is never stored");
  }
  return problems;
}

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
