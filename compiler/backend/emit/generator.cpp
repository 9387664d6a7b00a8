// SPDX-License-Identifier: Apache-2.0
// Bundle tables, and the shaders and commands of map passes.
#include "compiler/backend/emit/generator.h"

#include <algorithm>
#include <functional>
#include <set>
#include <utility>

#include "compiler/backend/analysis/same_in_run.h"
#include "compiler/backend/analysis/uses.h"
#include "compiler/ir/pins.h"
#include "compiler/ir/symbols.h"

namespace dr::backend {

using glsl::dim_expression;
using glsl::Shader;
using ir::Dim;
using ir::Extent;
using ir::OpKind;
using ir::ValueId;

Dim element_count(const Extent& extent) { return extent.w * extent.h * extent.l; }

std::unique_ptr<bundle::ExtentT> bundle_extent(const Extent& extent) {
  auto out = std::make_unique<bundle::ExtentT>();
  out->w = extent.w.str();
  out->h = extent.h.str();
  out->l = extent.l.str();
  return out;
}

std::unique_ptr<bundle::TypeT> bundle_type(const ir::Type& type) {
  auto out = std::make_unique<bundle::TypeT>();
  out->scalar = static_cast<bundle::Scalar>(type.scalar);
  out->rows = type.rows;
  out->cols = type.cols;
  return out;
}

namespace {

// Extents that programs compute with, as ints.
std::vector<std::string> computed_extents(const ir::Graph& graph) {
  std::set<std::string> numbers;
  for (uint32_t k = 0; k < graph.op_count(); ++k)
    if (const ir::Op& op = graph.op(ir::OpId{k}); op.kind == OpKind::DimValue)
      if (const Dim& dim = op.attrs.dims[0]; !dim.is_constant() && !dim.as_symbol()) numbers.insert(dim.str());
  return {numbers.begin(), numbers.end()};
}

}  // namespace

void Generator::process(bundle::BundleT& bundle, std::vector<GlslShader>& shaders) {
  bundle_ = &bundle;
  shaders_ = &shaders;
  bundle.symbols = ir::symbols_of(graph_);
  bundle.numbers = computed_extents(graph_);
  bundle.files = source_lines_.files();
  for (const Resource& r : schedule_.resources) {
    auto out = std::make_unique<bundle::ResourceT>();
    out->name = r.name;
    out->storage = bundle::Storage::Buffer;
    out->role = bundle::Role::Value;
    out->type = bundle_type(r.type);
    out->extent = bundle_extent(r.extent);
    switch (r.storage) {
      case Resource::Storage::Leaf: out->role = bundle::Role::Leaf; break;
      case Resource::Storage::StepIndex: out->role = bundle::Role::StepIndex; break;
      case Resource::Storage::Buffer:
      case Resource::Storage::Entries:
      case Resource::Storage::Bits: break;
      case Resource::Storage::EpochEntries: out->role = bundle::Role::EpochEntries; break;
      case Resource::Storage::Halves: out->type = bundle_type(ir::vec(r.words(), ir::Scalar::Uint)); break;
      case Resource::Storage::Sums:
      case Resource::Storage::EmptiedSums:
      case Resource::Storage::ListedSums:
        out->role = r.is(Resource::Storage::EmptiedSums) ? bundle::Role::Zeros : bundle::Role::Scratch;
        out->type = bundle_type(ir::kUint);
        out->extent = bundle_extent({words_of_sums(r.type, r.extent, wide_atomics()), 1, 1});
        break;
      case Resource::Storage::Emptied:
        out->role = bundle::Role::Zeros;
        out->type = bundle_type(ir::kUint);
        out->extent = bundle_extent({element_count(r.extent) * Dim(r.words()), 1, 1});
        break;
      case Resource::Storage::Image: out->storage = bundle::Storage::Image; break;
      case Resource::Storage::Tile: out->storage = bundle::Storage::Tile; break;
    }
    bundle.resources.push_back(std::move(out));
  }
  for (size_t k = 0; k < graph_.leaves.size(); ++k) {
    const ir::Leaf& leaf = graph_.leaves[k];
    auto out = std::make_unique<bundle::LeafT>();
    out->name = leaf.name;
    out->kind = static_cast<bundle::LeafKind>(leaf.kind);
    out->type = bundle_type(leaf.type);
    out->extent = bundle_extent(leaf.extent);
    out->initial = leaf.initial;
    out->is_fixed = leaf.is_fixed;
    out->resource = static_cast<uint32_t>(k);
    out->table = leaf.table;
    if (!leaf.table.empty()) out->table_of = static_cast<int>(*graph_.leaf_index(leaf.table_of));
    bundle.leaves.push_back(std::move(out));
  }
  for (const StepSchedule& s : schedule_.steps)
    for (const Pass& pass : s.passes)
      if (const auto* map = pass.as<MapPass>())
        for (const ValueId v : map->partial) bundle.resources[s.stored.at(v).index]->partial = true;
  for (const StepSchedule& s : schedule_.steps) step(s);
}

void Generator::step(const StepSchedule& schedule) {
  step_ = &schedule;
  step_tables_.clear();
  bundle_->steps.push_back(std::make_unique<bundle::StepT>());
  out_ = bundle_->steps.back().get();
  out_->name = schedule.name;
  for (const auto& [value, id] : schedule.stored)
    if (schedule_.resources[id.index].is(Resource::Storage::StepIndex)) out_->step_index = static_cast<int>(id.index);
  kept_.clear();
  if (out_->step_index >= 0) count_on();
  for (size_t k = 0; k < schedule.passes.size(); ++k) {
    const Pass& pass = schedule.passes[k];
    const bool joins = k > 0 && schedule.passes[k - 1].stage == pass.stage;
    if (set_up_for(schedule, pass_id(k)) != nullptr) continue;  // that runs it
    const Pass* const setup = pass.setup() == nullptr ? nullptr : &schedule.pass(pass.setup()->pass);
    set_lines(pass, setup);
    ops_ = pass.ops.size() + (setup == nullptr ? 0 : setup->ops.size());
    std::visit(
        Overloaded{[&](const MapPass&) { map_pass(pass); },
                   [&](const FragmentPass&) { fragment_pass(pass, stage_inputs(schedule, k), joins); },
                   [&](const ReducePass&) { reduce_pass(pass); }, [&](const ScatterPass&) { scatter_pass(pass); },
                   [&](const RasterPass& raster) { raster_compute(pass, raster, graph_.op(pass.ops.back())); },
                   [&](const DrawnRasterPass&) { raster_hardware(pass, graph_.op(pass.ops.back())); }},
        pass.of_kind);
  }
  lines_.clear();
  ops_ = 0;
  std::vector<const ir::Op*> rasters;
  for (ir::OpId id : graph_.region(graph_.root()).ops)
    if (graph_.op(id).kind == OpKind::Raster && schedule.stored.count(graph_.op(id).results[0]) != 0)
      rasters.push_back(&graph_.op(id));
  for (const ir::Op* op : rasters) {
    auto results = std::make_unique<bundle::RasterResultsT>();
    for (const ValueId v : op->results)
      if (raster_part(graph_, v).what != ir::RasterResult::Order) results->resources.push_back(resource_index(v));
    if (resource(op->results[0]).is(Resource::Storage::Bits)) results->width = op->attrs.dims[0].str();
    out_->rasters.push_back(std::move(results));
  }
  for (const auto& [value, name] : ir::pin_names(graph_)) {
    if (schedule.stored.count(value) == 0) continue;
    auto pin = std::make_unique<bundle::OutputT>();
    pin->name = name;
    pin->resource = resource_index(value);
    out_->pins.push_back(std::move(pin));
  }
  list_needs(schedule);
  // Leaves change when the step ends: what else reads an old one then gets a copy of it first. An output stays what its
  // step saw, also when another step changes the leaf before it is read.
  std::set<uint32_t> changing;
  for (const StepSchedule& any : schedule_.steps)
    for (const auto& [leaf, value] : any.updates) changing.insert(leaf);
  auto source = [&](ValueId value) {
    const uint32_t index = resource_index(value);
    if (changing.count(index) != 0) keep(index);
    const auto kept = kept_.find(index);
    return kept == kept_.end() ? index : kept->second;
  };
  for (const auto& [name, value] : schedule.outputs) {
    auto output = std::make_unique<bundle::OutputT>();
    output->name = name;
    output->resource = source(value);
    out_->outputs.push_back(std::move(output));
  }
  std::vector<std::pair<uint32_t, uint32_t>> copies;
  for (const auto& [leaf, value] : schedule.updates)
    if (resource_index(value) != leaf) copies.emplace_back(source(value), leaf);  // else it is there already
  for (const auto& [from, to] : copies) {
    auto& c = command(bundle::CommandKind::Copy, "update " + schedule_.resources[to].name);
    c.source = static_cast<int>(from);
    c.target = static_cast<int>(to);
  }
}

void Generator::keep(uint32_t resource) {
  if (kept_.count(resource) != 0) return;
  auto copy = std::make_unique<bundle::ResourceT>(*bundle_->resources[resource]);
  copy->name += "_before";
  copy->role = bundle::Role::Value;
  bundle_->resources.push_back(std::move(copy));
  kept_[resource] = static_cast<uint32_t>(bundle_->resources.size() - 1);
  auto& c = command(bundle::CommandKind::Copy, "keep " + schedule_.resources[resource].name);
  c.source = static_cast<int>(resource);
  c.target = static_cast<int>(kept_[resource]);
}

// The step counts on before its passes, beside the first of them, where one that changes the leaves would have to be
// waited for: they read a number that is one too large.
void Generator::count_on() {
  const auto index = static_cast<uint32_t>(out_->step_index);
  const auto counts = [&](const auto& named) { return resource_index(named.second) == index; };
  if (std::ranges::any_of(step_->outputs, counts) || std::ranges::any_of(step_->updates, counts)) keep(index);
  Shader s = shader();
  const std::string counter =
      s.bind_words(static_cast<uint32_t>(out_->step_index), "counter", bundle::Access::ReadWrite, "int");
  linear_index(s, "1");
  s.body().line(counter + ".d[0] = " + counter + ".d[0] + 1;");
  auto& c = command(bundle::CommandKind::Dispatch, "count_on");
  c.compute = add_shader("count_on", bundle::Stage::Compute, s);
  c.bindings = s.take_bindings();
  c.elements = "1";
  c.push = {0, 0, 0};
}

// The leaves and symbols without which the step cannot run.
void Generator::list_needs(const StepSchedule& schedule) {
  std::vector<ValueId> roots;
  std::set<uint32_t> leaves;
  std::set<std::string> symbols;
  for (const auto& output : schedule.outputs) roots.push_back(output.second);
  for (const auto& [leaf, value] : schedule.updates) {
    roots.push_back(value);
    leaves.insert(leaf);
  }
  const auto add = [&](const ir::Dim& dim) {
    for (const std::string& symbol : dim.symbols()) symbols.insert(symbol);
  };
  const auto add_extent = [&](const ir::Extent& extent) {
    add(extent.w);
    add(extent.h);
    add(extent.l);
  };
  const std::function<void(const ir::Op&)> visit = [&](const ir::Op& op) {
    if (op.kind == OpKind::Leaf) leaves.insert(*graph_.leaf_index(op.attrs.text));
    for (const ir::Dim& dim : op.attrs.dims) add(dim);
    for (const ValueId result : op.results) add_extent(graph_.value(result).extent);
    for (const ir::RegionId region : op.regions) {
      for (const ir::OpId inner : graph_.region(region).ops) visit(graph_.op(inner));
    }
  };
  if (!roots.empty()) {
    const std::vector<bool> live = ir::live_ops(graph_, roots);
    for (const ir::OpId id : graph_.region(graph_.root()).ops) {
      if (live[id.index]) visit(graph_.op(id));
    }
  }
  for (const uint32_t leaf : leaves) add_extent(graph_.leaves[leaf].extent);
  leaves.insert(step_tables_.begin(), step_tables_.end());
  out_->leaves.assign(leaves.begin(), leaves.end());
  out_->symbols.assign(symbols.begin(), symbols.end());
}

void Generator::set_lines(const Pass& pass, const Pass* setup) {
  std::set<std::pair<uint32_t, uint32_t>> lines;
  std::function<void(ir::OpId)> add = [&](ir::OpId id) {
    if (const auto line = source_lines_.of(id)) lines.emplace(line->file(), line->line());
    for (ir::RegionId region : graph_.op(id).regions)
      for (ir::OpId inner : graph_.region(region).ops) add(inner);
  };
  for (const Pass* each : {&pass, setup})
    if (each != nullptr)
      for (ir::OpId id : each->ops) add(id);
  lines_.clear();
  for (const auto& [file, line] : lines) lines_.emplace_back(file, line);
}

int Generator::add_shader(const std::string& name, bundle::Stage stage, Shader& shader, int group) {
  std::string source = shader.finish(stage == bundle::Stage::Compute ? compute_layout(group) : "");
  // Passes whose texts differ in names alone have one shader: drivers take long to compile one.
  const std::string key =
      std::string(bundle::EnumNameStage(stage)) + (shader.native() ? " native\n" : "\n") + glsl::without_names(source);
  const auto [it, is_new] = shader_of_.emplace(key, shaders_->size());
  if (is_new) shaders_->push_back({{}, stage, std::move(source), shader.native(), shader.extensions()});
  auto& names = (*shaders_)[it->second].names;
  if (std::ranges::find(names, name) == names.end()) names.push_back(name);
  return static_cast<int>(it->second);
}

uint32_t Generator::add_scratch(const std::string& name, const std::string& words, const ir::Type& type) {
  auto out = std::make_unique<bundle::ResourceT>();
  out->name = name;
  out->role = bundle::Role::Scratch;
  out->type = bundle_type(type);
  out->extent = bundle_extent({});
  out->extent->w = words;
  bundle_->resources.push_back(std::move(out));
  return static_cast<uint32_t>(bundle_->resources.size() - 1);
}

uint32_t Generator::add_watch(const std::string& name) {
  const uint32_t watch = add_scratch(name, "1");
  bundle_->resources[watch]->role = bundle::Role::Watch;
  return watch;
}

bundle::CommandT& Generator::command(bundle::CommandKind kind, const std::string& label) {
  out_->commands.push_back(std::make_unique<bundle::CommandT>());
  bundle::CommandT& c = *out_->commands.back();
  c.kind = kind;
  c.label = label;
  c.lines = lines_;
  if (kind != bundle::CommandKind::Fill) c.ops = static_cast<uint32_t>(std::exchange(ops_, 0));
  return c;
}

void Generator::fill(const std::string& label, uint32_t target, uint32_t value, const std::string& words) {
  auto& c = command(bundle::CommandKind::Fill, label);
  c.elements = words;
  c.target = static_cast<int>(target);
  c.value = value;
}

bundle::CommandT& Generator::dispatch(const Pass& pass, const std::string& suffix, Shader& s,
                                      const std::string& elements, std::vector<int> push, int group) {
  auto& c = command(bundle::CommandKind::Dispatch, pass.name + suffix);
  c.compute = add_shader(pass.name + suffix, bundle::Stage::Compute, s, group);
  c.group = static_cast<uint32_t>(group);
  c.bindings = s.take_bindings();
  c.elements = elements;
  c.push = std::move(push);
  c.finite = std::exchange(finite_, -1);
  return c;
}

void linear_index(Shader& s, const std::string& elements) {
  s.body().line(
      "int index = int((gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x) * gl_WorkGroupSize.x + "
      "gl_LocalInvocationID.x);");
  if (!elements.empty()) s.body().line("if (index >= " + elements + ") return;");
}

void place_from_index(Shader& s, const Extent& e, const std::string& index) {
  if (e.h.is_one() && e.l.is_one()) return s.body().line("ivec3 at = ivec3(" + index + ", 0, 0);");
  const std::string w = dim_expression(e.w), h = dim_expression(e.h);
  s.body().line("ivec3 at = ivec3(" + index + " % " + w + ", (" + index + " / " + w + ") % " + h + ", " + index +
                " / (" + w + " * " + h + "));");
}

RunReads Generator::reads_in_runs(const Pass& pass, const std::set<ValueId>& but) const {
  const MapCode& code = pass.get<MapPass>().code;
  if (!code.lists_in_runs || code.cut) return {};
  return {reads_of_runs(graph_, pass.ops, pass.domain.w, kListedRun, but),
          reads_beside(graph_, pass.ops, pass.domain, kListedRun)};
}

void Generator::map_pass(const Pass& pass) {
  const auto& map = pass.get<MapPass>();
  const std::vector<const Pass*> scatters = listed_for(pass);
  size_t targets = 0;
  for (const Pass* scatter : scatters) {
    if (scatter->get<ScatterPass>().joined_run() != nullptr)
      targets += (targets_[scatter] = scatter_targets(*scatter, targets)).size();
    if (scatter->get<ScatterPass>().leaves_list())
      active_lists_[scatter] = add_list(*scatter, "active", bundle::ListKind::Active);
  }
  if (map.rest) return stepped_map_pass(pass);
  if (map.block) return block_map_pass(pass, *map.block);
  if (map.code.each > 1) return strided_map_pass(pass);
  if (map.code.heavy) return listed_map_pass(pass, *map.code.heavy);
  Shader s = shader();
  const RunReads shared = reads_in_runs(pass);
  ListingLoop loop(s, pass.domain, map.code.lists_in_runs, map.code.in_tiles, shared);
  const Cut cut = this->cut(s, pass, map.code.cut, loop.element(), loop.each());
  open_cut(s, cut, loop.skip());
  take_sums(s, pass);
  s.element_ops(without(pass.ops, shared.ops()));
  close_cut(s, cut);
  store_results(s, pass, scatters, &loop);
  end_cut(s, cut);
  const std::string count = loop.close();
  const bool joins =
      std::ranges::any_of(scatters, [](const Pass* scatter) { return scatter->get<ScatterPass>().joins_groups(); });
  set_trips(dispatch(pass, "", s, count, {0, 0, 0}, joins ? map.code.joining_group : 0), cut);
}

void Generator::fragment_pass(const Pass& pass, const std::vector<ValueId>& inputs, bool joins) {
  Shader vertex = shader();
  vertex.body().line(
      "gl_Position = vec4(gl_VertexIndex == 1 ? 3.0 : -1.0, gl_VertexIndex == 2 ? 3.0 : -1.0, 0.5, 1.0);");
  Shader s = shader();
  s.body().line("ivec3 at = ivec3(ivec2(gl_FragCoord.xy), " + drawn_layer(s, pass.domain.l) + ");");
  auto& c = command(bundle::CommandKind::Draw, pass.name);
  c.joins = joins;
  for (ValueId v : inputs) {
    s.read_as_input(v);
    c.inputs.push_back(resource_index(v));
  }
  s.element_ops(pass.ops);
  for (ValueId v : pass.writes) {
    const ir::Type& t = resource(v).type;
    const std::string out = "out_" + std::to_string(c.colors.size());
    const ir::Type wide = t.is_bool() ? t.with_scalar(ir::Scalar::Uint) : t;
    // Three components go into a four-component image.
    const ir::Type texel = t.rows == 3 ? ir::vec(4, wide.scalar) : wide;
    s.declare("layout(location = " + std::to_string(c.colors.size()) + ") out " + texel.str() + " " + out + ";\n");
    std::string value = s.use(v);
    if (t.is_bool()) value = wide.str() + "(" + value + ")";
    s.body().line(out + " = " + (t.rows == 3 ? texel.str() + "(" + value + ", 0)" : value) + ";");
    c.colors.push_back(resource_index(v));
    c.clear.push_back(0);
  }
  c.vertex = add_shader("full_screen", bundle::Stage::Vertex, vertex);
  c.fragment = add_shader(pass.name, bundle::Stage::Fragment, s);
  c.bindings = s.take_bindings();
  c.elements = "3";
  c.extent = bundle_extent(pass.domain);
  c.push = {0, 0, 0};
}

}  // namespace dr::backend
