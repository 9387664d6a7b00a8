// SPDX-License-Identifier: Apache-2.0
// Bundle tables, and the shaders and commands of map and reduce passes.
#include "compiler/backend/emit/generator.h"

#include <algorithm>
#include <functional>
#include <set>
#include <utility>

#include "compiler/ir/pins.h"

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

std::vector<std::string> all_symbols(const ir::Graph& graph) {
  std::set<std::string> symbols;
  auto add = [&](const Dim& dim) {
    for (std::string& s : dim.symbols()) symbols.insert(std::move(s));
  };
  for (const ir::Leaf& leaf : graph.leaves)
    for (const Dim* d : {&leaf.extent.w, &leaf.extent.h, &leaf.extent.l}) add(*d);
  for (uint32_t k = 0; k < graph.op_count(); ++k)
    for (const Dim& d : graph.op(ir::OpId{k}).attrs.dims) add(d);
  for (uint32_t k = 0; k < graph.value_count(); ++k) {
    const Extent& e = graph.value(ValueId{k}).extent;
    for (const Dim* d : {&e.w, &e.h, &e.l}) add(*d);
  }
  return {symbols.begin(), symbols.end()};
}

}  // namespace

void Generator::process(bundle::BundleT& bundle, std::vector<GlslShader>& shaders) {
  bundle_ = &bundle;
  shaders_ = &shaders;
  bundle.symbols = all_symbols(graph_);
  bundle.files = source_lines_.files();
  for (const Resource& r : schedule_.resources) {
    auto out = std::make_unique<bundle::ResourceT>();
    out->name = r.name;
    out->storage = r.storage == Resource::Storage::Image  ? bundle::Storage::Image
                   : r.storage == Resource::Storage::Tile ? bundle::Storage::Tile
                                                          : bundle::Storage::Buffer;
    out->role = r.leaf >= 0 ? bundle::Role::Leaf : r.step_index ? bundle::Role::StepIndex : bundle::Role::Value;
    out->type = bundle_type(r.half ? ir::vec(r.words(), ir::Scalar::Uint) : r.type);
    out->extent = bundle_extent(r.extent);
    if (r.sums) {
      out->role = bundle::Role::Scratch;
      out->type = bundle_type(ir::kUint);
      out->extent = bundle_extent({words_of_sums(r.type, r.extent, wide_atomics()), 1, 1});
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
    out->resource = static_cast<uint32_t>(k);
    out->table = leaf.table;
    if (!leaf.table.empty()) out->table_of = static_cast<int>(*graph_.leaf_index(leaf.table_of));
    bundle.leaves.push_back(std::move(out));
  }
  for (const StepSchedule& s : schedule_.steps)
    for (const Pass& pass : s.passes)
      for (const ValueId v : pass.partial) bundle.resources[s.stored.at(v).index]->partial = true;
  for (const StepSchedule& s : schedule_.steps) step(s);
}

void Generator::step(const StepSchedule& schedule) {
  step_ = &schedule;
  step_tables_.clear();
  bundle_->steps.push_back(std::make_unique<bundle::StepT>());
  out_ = bundle_->steps.back().get();
  out_->name = schedule.name;
  for (const auto& [value, id] : schedule.stored)
    if (schedule_.resources[id.index].step_index) out_->step_index = static_cast<int>(id.index);
  for (size_t k = 0; k < schedule.passes.size(); ++k) {
    const Pass& pass = schedule.passes[k];
    const bool joins = k > 0 && schedule.passes[k - 1].stage == pass.stage;
    const bool later =
        std::ranges::any_of(schedule.passes, [&](const Pass& other) { return other.set_up_by == static_cast<int>(k); });
    if (later) continue;
    const Pass* const setup = pass.set_up_by < 0 ? nullptr : &schedule.passes[static_cast<size_t>(pass.set_up_by)];
    set_lines(pass, setup);
    ops_ = pass.ops.size() + (setup == nullptr ? 0 : setup->ops.size());
    switch (pass.kind) {
      case Pass::Kind::Map:
        pass.hardware ? fragment_pass(pass, stage_inputs(schedule, k), joins) : map_pass(pass);
        break;
      case Pass::Kind::Reduce: reduce_pass(pass); break;
      case Pass::Kind::Scatter: scatter_pass(pass); break;
      case Pass::Kind::Raster: raster_pass(pass); break;
    }
  }
  lines_.clear();
  ops_ = 0;
  std::vector<const ir::Op*> rasters;
  for (ir::OpId id : graph_.region(graph_.root()).ops)
    if (graph_.op(id).kind == OpKind::Raster && schedule.stored.count(graph_.op(id).results[0]) != 0)
      rasters.push_back(&graph_.op(id));
  for (const ir::Op* op : rasters) {
    auto results = std::make_unique<bundle::RasterResultsT>();
    for (ValueId v : op->results) results->resources.push_back(resource_index(v));
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
  // Leaves and the counter change when the step ends: what else reads an old one then gets a copy of it first.
  // An output stays what its step saw, also when another step changes the leaf before it is read.
  std::set<uint32_t> changing;
  for (const StepSchedule& any : schedule_.steps)
    for (const auto& [leaf, value] : any.updates) changing.insert(leaf);
  std::map<uint32_t, uint32_t> snapshots;
  auto source = [&](ValueId value) {
    const uint32_t index = resource_index(value);
    const bool changes = schedule_.resources[index].step_index || changing.count(index) != 0;
    if (!changes) return index;
    if (auto it = snapshots.find(index); it != snapshots.end()) return it->second;
    auto copy = std::make_unique<bundle::ResourceT>(*bundle_->resources[index]);
    copy->name += "_before";
    copy->role = bundle::Role::Value;
    bundle_->resources.push_back(std::move(copy));
    const auto to = static_cast<uint32_t>(bundle_->resources.size() - 1);
    auto& c = command(bundle::CommandKind::Copy, "keep " + schedule_.resources[index].name);
    c.source = static_cast<int>(index);
    c.target = static_cast<int>(to);
    snapshots[index] = to;
    return to;
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
  if (out_->step_index >= 0) count_on();
}

void Generator::count_on() {
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

int Generator::add_shader(const std::string& name, bundle::Stage stage, Shader& shader) {
  std::string source = shader.finish(stage == bundle::Stage::Compute ? compute_layout() : "");
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
                                      const std::string& elements, std::vector<int> push) {
  auto& c = command(bundle::CommandKind::Dispatch, pass.name + suffix);
  c.compute = add_shader(pass.name + suffix, bundle::Stage::Compute, s);
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
  const std::string w = dim_expression(e.w), h = dim_expression(e.h);
  s.body().line("ivec3 at = ivec3(" + index + " % " + w + ", (" + index + " / " + w + ") % " + h + ", " + index +
                " / (" + w + " * " + h + "));");
}

void Generator::map_pass(const Pass& pass) {
  if (const Pass* scatter = listed_for(pass)) {
    if (scatter->joins_lister) targets_[scatter] = scatter_targets(*scatter);
    const bool all_here = scatter->joins_lister && scatter->scatter == ScatterLowering::Atomic;
    if (!all_here) active_lists_[scatter] = add_list(*scatter, "active");
  }
  if (!pass.code.heavy.empty()) return listed_map_pass(pass);
  Shader s = shader();
  ListingLoop loop(s, pass.domain, pass.code.lists_in_runs);
  const Cut cut = this->cut(s, pass, pass.code.cut, loop.element(), loop.each());
  open_cut(s, cut, loop.skip());
  s.element_ops(pass.ops);
  close_cut(s, cut);
  store_results(s, pass, &loop);
  end_cut(s, cut);
  const std::string count = loop.close();
  set_trips(dispatch(pass, "", s, count), cut);
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

void Generator::reduce_pass(const Pass& pass) {
  const ir::Op& op = graph_.op(pass.ops[0]);
  const ValueId source = op.operands[0], target = op.results[0];
  const ir::Type type = resource(target).type;
  const Extent& from = resource(source).extent;
  const Dim* const axes[] = {&from.w, &from.h, &from.l};
  Dim outs = 1, count = 1;
  for (size_t a = 0; a < 3; ++a)
    (op.attrs.ints[a] != 0 ? count : outs) = (op.attrs.ints[a] != 0 ? count : outs) * *axes[a];
  const int n = type.components();

  // Folds up to 64 inputs in groups of eight: a fixed tree, whatever the lowering.
  auto fold = [&](Shader& s, const std::string& read, const std::string& target_name) {
    const bool sum = op.kind == OpKind::ReduceSum;
    const std::string first = sum ? glsl::zero(type) : glsl::limit(type, op.kind == OpKind::ReduceMin);
    auto combine = [&](const std::string& into, const std::string& what) {
      if (sum) {
        s.body().line(into + " = " + into + " + " + what + ";");
        return;
      }
      for (int c = 0; c < n; ++c) {
        const std::string now = glsl::component(type, into, c), other = glsl::component(type, what, c);
        s.body().line("if (" + other + (op.kind == OpKind::ReduceMin ? " < " : " > ") + now + ") " + now + " = " +
                      other + ";");
      }
    };
    s.body().line(type.str() + " total = " + first + ";");
    s.body().line("int end = min(begin + 64, pc.a);");
    s.body().line("for (int g = begin; g < end; g += 8) {");
    s.body().line(type.str() + " part = " + first + ";");
    s.body().line("int stop = min(g + 8, end);");
    s.body().line("for (int r = g; r < stop; ++r) {");
    s.body().line(type.str() + " x = " + read + ";");
    combine("part", "x");
    s.body().line("}");
    combine("total", "part");
    s.body().line("}");
    for (int c = 0; c < n; ++c)
      s.body().line(target_name + ".d[index * " + std::to_string(n) + " + " + std::to_string(c) +
                    "] = " + glsl::component(type, "total", c) + ";");
  };
  auto begin = [&](Shader& s) {
    linear_index(s, dim_expression(outs) + " * pc.b");
    s.body().line("int o = index / pc.b;");
    s.body().line("int begin = (index % pc.b) * 64;");
  };
  const std::string word = glsl::storage_scalar(type.scalar);

  Shader first = strict_shader();
  begin(first);
  // Element r of result o: both count through their axes, x fastest.
  std::string function = "ivec3 source_place(int o, int r) {\n  ivec3 at = ivec3(0);\n";
  for (const bool reduced : {true, false}) {
    std::string counter = reduced ? "r" : "o";
    for (size_t a = 0; a < 3; ++a) {
      if ((op.attrs.ints[a] != 0) != reduced || axes[a]->is_one()) continue;
      const std::string d = dim_expression(*axes[a]);
      function += "  at[" + std::to_string(a) + "] = " + counter + " % " + d + "; " + counter + " /= " + d + ";\n";
    }
  }
  first.load(source, "at");
  first.declare(function + "  return at;\n}\n");
  const std::string load = first.load(source, "source_place(o, r)");
  // The target is bound by number: the first stage may write it or scratch.
  const uint32_t a = add_scratch(pass.name + "_partials", ((count + 63).divided_by(64) * outs * Dim(n)).str());
  const uint32_t b = add_scratch(pass.name + "_partials_2", ((count + 4095).divided_by(4096) * outs * Dim(n)).str());
  const std::string out_name = first.bind_words(a, "partials", bundle::Access::Write, word.c_str());
  fold(first, load, out_name);

  Shader next = strict_shader();
  begin(next);
  const std::string in = next.bind_words(a, "inputs", bundle::Access::Read, word.c_str());
  const std::string out = next.bind_words(b, "partials", bundle::Access::Write, word.c_str());
  std::string words;
  for (int c = 0; c < n; ++c)
    words += (c ? ", " : "") + in + ".d[(o * pc.a + r) * " + std::to_string(n) + " + " + std::to_string(c) + "]";
  fold(next, type.is_scalar() ? words : type.str() + "(" + words + ")", out);

  auto& c = command(bundle::CommandKind::Reduce, pass.name);
  c.compute = add_shader(pass.name, bundle::Stage::Compute, first);
  c.bindings = first.take_bindings();
  c.bindings.pop_back();  // the output: target or scratch, as the sizes have it
  c.next = add_shader(pass.name + "_next", bundle::Stage::Compute, next);
  c.target = static_cast<int>(resource_index(target));
  c.outs = outs.str();
  c.count = count.str();
  c.scratch_a = static_cast<int>(a);
  c.scratch_b = static_cast<int>(b);
  c.push = {0, 0, 0};
}

}  // namespace dr::backend
