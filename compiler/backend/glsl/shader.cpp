// SPDX-License-Identifier: Apache-2.0
// Element computation of a generated shader.
#include "compiler/backend/glsl/shader.h"

#include <algorithm>

#include "compiler/backend/analysis/shared_loops.h"
#include "compiler/backend/glsl/inside.h"
#include "compiler/ir/yields.h"
#include "compiler/ops/native.h"
#include "compiler/ops/op.h"
#include "compiler/ops/prelude.h"

namespace dr::backend::glsl {

using ir::Extent;
using ir::Op;
using ir::OpKind;
using ir::Type;
using ir::ValueId;
using ir::Yield;

Shader::Shader(const ir::Graph& graph, const Schedule& schedule, const StepSchedule& step,
               const std::vector<std::string>& symbols, std::vector<std::string>& numbers, bool native,
               SumsReader sums_reader)
    : graph_(graph),
      schedule_(schedule),
      step_(step),
      symbols_(symbols),
      numbers_(numbers),
      native_(native),
      sums_reader_(std::move(sums_reader)) {}

std::string Shader::unique(std::string_view base) {
  // No symbol, generated function, block or stage variable starts with this, so a user's name can hide none.
  std::string stem = "v_" + sanitize(base);
  const int number = names_[stem]++;
  return std::move(stem) + "_" + std::to_string(number);
}

void Shader::prelude(std::string_view text) {
  if (native_) text = ops::native_prelude(text);
  if (text.empty() || std::find(preludes_.begin(), preludes_.end(), text) != preludes_.end()) return;
  preludes_.emplace_back(text);
}

bool Shader::is_defined(ValueId value) const {
  return std::ranges::any_of(scopes_, [&](const auto& scope) { return scope.count(value) != 0; });
}

void Shader::define(ValueId value, std::string expression) {
  if (common_) know(value, expression);
  scopes_.back()[value] = std::move(expression);
}

std::string Shader::use(ValueId value) {
  for (auto scope = scopes_.rbegin(); scope != scopes_.rend(); ++scope)
    if (auto it = scope->find(value); it != scope->end()) return it->second;
  DR_ASSERT(step_.stored.count(value) != 0);
  std::string name = unique(resource(value).is_entries() || is_bit(value) ? part_name(value) : resource(value).name);
  body_.line(graph_.value(value).type.str() + " " + name + " = " + load(value, at_) + ";");
  define(value, name);
  return name;
}

std::string Shader::result(ValueId value, const std::string& expression) {
  const ir::ValueInfo& info = graph_.value(value);
  std::string name = unique(info.name.empty() ? std::string(ir::op_name(graph_.op(info.op).kind)) : info.name);
  body_.line(info.type.str() + " " + name + " = " + expression + ";");
  define(value, name);
  return name;
}

std::string Shader::place_of(ValueId index_value, const std::string& index, const Extent& extent) const {
  const int n = graph_.value(index_value).type.rows;
  const std::string layer = extent.l.is_one() ? "0" : at_ + ".z";
  if (n == 1) return "ivec3(" + index + ", 0, " + layer + ")";
  if (n == 2) return "ivec3(" + index + ", " + layer + ")";
  return index;
}

std::string Shader::scatter(const Accumulator& accumulator, ValueId index_value, const std::string& index,
                            const std::string& value) const {
  return "scatter_" + accumulator.name + "(" + place_of(index_value, index, accumulator.extent) + ", " + value +
         (accumulator.site.empty() ? "" : ", " + accumulator.site) + ");";
}

std::string Shader::hiding_zeros(const Type& type, std::span<const double> components) {
  hides_ = true;
  return literal(type, components, "hidden_0");
}

std::string Shader::hidden_zero(const Type& type) {
  if (!type.is_float()) return zero(type);
  return hiding_zeros(type, std::vector<double>(static_cast<size_t>(type.components()), 0.0));
}

void Shader::element_ops(const std::vector<ir::OpId>& ops) {
  if (running_.size() > 1) {
    for (const ir::OpId id : ops) op_of_all(graph_.op(id));
    return;
  }
  // Loops that stop and go on are cut where they stand in the text.
  const std::vector<Together> order = cut_ || common_ ? std::vector<Together>() : alike_together(graph_, ops);
  if (order.empty())
    for (const ir::OpId id : ops) op(graph_.op(id));
  for (const Together& together : order) {
    if (together.ops.size() > 1 && may_loop(together)) {
      alike_ops(together);
      continue;
    }
    for (const ir::OpId id : together.ops) op(graph_.op(id));
  }
}

std::vector<std::string> Shader::region(ir::RegionId id) {
  const ir::Region& region = graph_.region(id);
  element_ops(region.ops);
  std::vector<std::string> out;
  for (ValueId v : region.yields) out.push_back(graph_.value(v).accumulation ? std::string() : use(v));
  return out;
}

void Shader::op(const Op& op) {
  if (common_ && common_op(op)) return;
  switch (op.kind) {
    case OpKind::Const: {
      const Type& type = graph_.value(op.results[0]).type;
      const bool hides = schedule_.code.hidden_zeros && type.is_float();
      define(op.results[0], hides ? hiding_zeros(type, op.attrs.floats) : literal(type, op.attrs.floats));
      return;
    }
    case OpKind::DimValue: define(op.results[0], dim_expression(op.attrs.dims[0])); return;
    case OpKind::Coord: {
      const auto axis = static_cast<size_t>(op.attrs.ints[0]);
      static const char* const kAxis[] = {".x", ".y", ".z"};
      define(op.results[0], op.attrs.dims[axis].is_one() ? "0" : at_ + kAxis[axis]);
      return;
    }
    case OpKind::Leaf:
    case OpKind::StepIndex: return;  // read where used
    case OpKind::Broadcast:
    case OpKind::Pin:
    case OpKind::Detach: define(op.results[0], use(op.operands[0])); return;
    case OpKind::Gather: {
      if (const auto shared = shared_read(op)) {
        result(op.results[0], *shared);
        return;
      }
      const std::string place = place_of(op.operands[1], use(op.operands[1]), graph_.value(op.operands[0]).extent);
      result(op.results[0], is_inside(graph_, op) ? load(op.operands[0], place) : gather(op.operands[0], place));
      return;
    }
    case OpKind::Shift: {
      // On an axis of extent 1, where the shader may run over more elements, every other place is outside.
      const Extent& e = graph_.value(op.operands[0]).extent;
      const std::string from = "ivec3(" + (e.w.is_one() ? "0" : at_ + ".x") + ", " + (e.h.is_one() ? "0" : at_ + ".y") +
                               ", " + (e.l.is_one() ? "0" : at_ + ".z") + ")";
      const bool whole = !e.w.is_one() && !e.h.is_one() && !e.l.is_one();
      result(op.results[0],
             gather(op.operands[0], (whole ? at_ : from) + " + ivec3(" + std::to_string(op.attrs.ints[0]) + ", " +
                                        std::to_string(op.attrs.ints[1]) + ", 0)"));
      return;
    }
    case OpKind::If: if_op(op); return;
    case OpKind::Reduce: reduce_op(op); return;
    case OpKind::Fold: fold_op(op); return;
    case OpKind::ScatterAdd:
    case OpKind::ScatterMax: {
      const auto it = accumulators_.find(op.results[0]);
      DR_ASSERT(it != accumulators_.end());
      const std::string index = use(op.operands[0]);
      effect(scatter(it->second, op.operands[0], index, use(op.operands[1])));
      return;
    }
    case OpKind::ReduceSum:
    case OpKind::ReduceMin:
    case OpKind::ReduceMax:
    case OpKind::Raster:
    case OpKind::Vjp:
    case OpKind::Cotangent:
    case OpKind::Grad: DR_ICE("op '" + std::string(ir::op_name(op.kind)) + "' has no element-wise form");
#define DR_OP(kind, name)
#define DR_ELEMENTWISE(kind, name) case OpKind::kind:
#include "compiler/ir/op_kinds.def"
#undef DR_OP
      elementwise_op(op);
      return;
  }
}

bool Shader::is_hidden(ValueId divisor) const {
  const Code& code = schedule_.code;
  return code.hidden_divisors.contains(divisor) || (!native_ && code.strict_hidden_divisors.contains(divisor));
}

void Shader::elementwise_op(const Op& op) {
  const ops::OpInfo& info = ops::info(op.kind);
  DR_ASSERT(info.glsl != nullptr);
  std::vector<std::string> operands;
  std::vector<Type> types;
  for (ValueId v : op.operands) {
    operands.push_back(use(v));
    types.push_back(graph_.value(v).type);
  }
  const bool divides = op.kind == OpKind::Div && types[1].is_float();
  if (divides && is_hidden(op.operands[1])) {
    hides_ = true;
    // By `|`: what is hidden already stays so, as x | x is x.
    operands[1] = "uintBitsToFloat(floatBitsToUint(" + operands[1] + ") | hidden_0u)";
  }
  const ops::GlslInput input{operands, types, op.attrs, graph_.value(op.results[0]).type};
  if (divides && divides_as_is(op.operands[1])) {
    result(op.results[0], operands[0] + " / " + operands[1]);
    return;
  }
  if (const auto own = native_ ? ops::native_glsl(op.kind, input) : std::nullopt) {
    result(op.results[0], *own);
    return;
  }
  for (std::string_view text : ops::prelude(info, input)) prelude(text);
  result(op.results[0], info.glsl(input));
}

void Shader::forward_accumulators(const Op& op, ir::RegionId region) {
  const std::vector<ir::Yielded> parts = ir::yielded(graph_, op, region);
  for (size_t k = 0; k < op.results.size(); ++k) {
    if (op.attrs.yields[k] != Yield::Scatter || parts[k].index.valid()) continue;
    if (auto it = accumulators_.find(op.results[k]); it != accumulators_.end())
      accumulators_[parts[k].value] = it->second;
  }
}

// What a region yields for each result.
std::vector<Shader::Part> Shader::parts(const Op& op, ir::RegionId region) {
  std::vector<Part> all;
  for (const ir::Yielded& part : ir::yielded(graph_, op, region)) {
    std::string index = part.index.valid() ? use(part.index) : "";
    all.push_back({std::move(index), graph_.value(part.value).accumulation ? "" : use(part.value), part.index});
  }
  return all;
}

// Runs a region and combines what it yields into the op's results; `trip` is the loop variable of a loop.
void Shader::yields(const Op& op, ir::RegionId region, const std::vector<std::string>& names, const std::string& trip) {
  element_ops(graph_.region(region).ops);
  const std::vector<Part> all = parts(op, region);
  if (ir::is_loop(op.kind) && cut_) cut_->finish_trip(body_);
  combine(op, names, trip, all);
}

void Shader::combine(const Op& op, const std::vector<std::string>& names, const std::string& trip,
                     const std::vector<Part>& all) {
  const bool in_loop = ir::is_loop(op.kind);
  for (size_t k = 0; k < op.results.size(); ++k) {
    const Type& type = graph_.value(op.results[k]).type;
    const std::string& y = all[k].value;
    switch (op.attrs.yields[k]) {
      case Yield::Element: body_.line(names[k] + " = " + y + ";"); break;
      case Yield::Sum: body_.line(names[k] + " = " + names[k] + " + " + y + ";"); break;
      case Yield::Min:
      case Yield::Max:
        for (int c = 0; c < type.components(); ++c)
          body_.line("if (" + component(type, y, c) + (op.attrs.yields[k] == Yield::Min ? " < " : " > ") +
                     component(type, names[k], c) + ") " + component(type, names[k], c) + " = " +
                     component(type, y, c) + ";");
        break;
      case Yield::ArgMin:
        body_.line("if (" + y + " < " + names[k] + "_best || (" + names[k] + "_none && " + y + " == " + names[k] +
                   "_best)) {");
        body_.line(names[k] + "_best = " + y + ";");
        body_.line(names[k] + "_none = false;");
        body_.line(names[k] + " = " + trip + ";");
        body_.line("}");
        break;
      case Yield::Scatter:
        if (auto it = accumulators_.find(op.results[k]); all[k].of.valid() && it != accumulators_.end()) {
          const std::string statement = scatter(it->second, all[k].of, all[k].index, y);
          in_loop ? body_.line(by_one(statement)) : effect(statement);
        }
        break;
    }
  }
}

// Whether the invocations of an element share the trips of a loop, which begins now.
bool Shader::begin_shared(const Op& op) {
  const bool shared = sharing_ && !sharing_->in_loop && !cut_ &&
                      (only_scatters(graph_, op) || (sharing_->combine && combines_in_any_order(graph_, op)));
  if (shared) sharing_->in_loop = true;
  return shared;
}

void Shader::end_shared(const Op& op, const std::vector<std::string>& names) {
  sharing_->in_loop = false;
  if (!sharing_->combine) return;
  std::string join;
  for (size_t k = 0; k < names.size(); ++k) {
    const std::string other = "subgroupShuffleXor(" + names[k] + ", lanes)";
    const Yield yield = op.attrs.yields[k];
    if (yield == Yield::Sum) join += " " + names[k] + " += " + other + ";";
    if (yield == Yield::Min || yield == Yield::Max)
      join += " " + names[k] + " = " + (yield == Yield::Min ? "min(" : "max(") + names[k] + ", " + other + ");";
  }
  body_.line("for (uint lanes = 1u; lanes < uint(" + sharing_->shares + "); lanes <<= 1) {" + join + " }");
}

// What begins the second branch.
void Shader::otherwise(const std::string& condition) {
  if (!schedule_.code.no_else) return body_.line("} else {");
  body_.line("}");
  body_.line("if (!" + condition + ") {");
}

void Shader::if_op(const Op& op) {
  const std::string condition = use(op.operands[0]);
  std::vector<std::string> names;
  for (size_t k = 0; k < op.results.size(); ++k) {
    const ir::ValueInfo& info = graph_.value(op.results[k]);
    names.push_back(op.attrs.yields[k] == Yield::Scatter ? std::string()
                                                         : unique(info.name.empty() ? "if" : info.name));
    if (!names.back().empty()) body_.line(info.type.str() + " " + names.back() + ";");
  }
  const bool left_out = !op.results.empty() && left_out_.count(op.results[0]) != 0;
  if (left_out) body_.line("{");
  for (size_t branch = left_out ? 1 : 0; branch < 2; ++branch) {
    forward_accumulators(op, op.regions[branch]);
    if (!left_out && branch == 0) body_.line("if (" + condition + ") {");
    if (!left_out && branch == 1) otherwise(condition);
    push_scope();
    yields(op, op.regions[branch], names, {});
    pop_scope();
  }
  body_.line("}");
  for (size_t k = 0; k < op.results.size(); ++k)
    if (!names[k].empty()) define(op.results[k], names[k]);
}

void Shader::choose_texels() {
  if (!schedule_.code.texel_reads) return;
  for (const auto& [resource, bound] : bound_) {
    Declared& declared = declared_[bound.binding];
    bundle::BindingT& binding = *bindings_[bound.binding];
    if (declared.texel == 0 || binding.access != bundle::Access::Read) continue;
    binding.texel = static_cast<uint8_t>(declared.texel);
    const char* prefix = declared.word == "float" ? "" : declared.word == "int" ? "i" : "u";
    declared.text = std::string("uniform ") + prefix + "textureBuffer " + bound.name + ";\n";
    extension("GL_EXT_samplerless_texture_functions");
  }
}

// The place of an extent among the numbers that the host computes.
size_t Shader::number_of(const ir::Dim& dim) {
  const std::string text = dim.str();
  const auto it = std::ranges::find(numbers_, text);
  const auto place = static_cast<size_t>(it - numbers_.begin());
  if (it == numbers_.end()) numbers_.push_back(text);
  return place;
}

std::string Shader::finish(const std::string& layout) {
  choose_texels();
  // For version 450, glslang takes twice as long to build its tables: 0.1 s more. All that is missed of it is this
  // `mix`.
  std::string out = "#version 440\n#extension GL_EXT_shader_integer_mix : require\n";
  for (const std::string& e : extensions_) out += "#extension " + e + " : require\n";
  out += layout;
  const auto constant = [&](size_t id, const std::string& name, int value, const std::string& comment = "") {
    out += "layout(constant_id = " + std::to_string(id) + ") const int " + name + " = " + std::to_string(value) + ";" +
           (comment.empty() ? "" : "  // " + comment) + "\n";
  };
  for (size_t k = 0; k < symbols_.size(); ++k) constant(k, symbol_name(symbols_[k]), 1);
  if (cut_) constant(symbols_.size() + 1, "part_trips", 0);
  const std::string rest = functions_and_main();
  for (const ir::Dim& division : host_divisions(rest))
    constant(symbols_.size() + 2 + number_of(division), division_name(division), 1, division.str());
  out += "layout(push_constant) uniform Push { int layer; int a; int b; int c; } pc;\n";
  // pc.c is 0 always. llvmpipe would read it lane by lane where a loop first does: here it reads it once.
  const bool stores = schedule_.code.hidden_stores;
  if (stores) out += "int pushed_zero = pc.c;\n";
  if (hides_)
    out += std::string("#define hidden_0u uint(") + (stores ? "pushed_zero" : "pc.c") +
           ")\n#define hidden_0 uintBitsToFloat(hidden_0u)\n";
  for (size_t k = 0; k < declared_.size(); ++k) {
    const bool image = declared_[k].text.starts_with("uniform");
    const auto input = std::find(inputs_.begin(), inputs_.end(), bindings_[k]->resource);
    static constexpr const char* kRights[] = {"readonly ", "writeonly ", ""};  // by bundle::Access
    out += "layout(";
    if (input != inputs_.end()) out += "input_attachment_index = " + std::to_string(input - inputs_.begin()) + ", ";
    out += "set = 0, binding = " + std::to_string(k) + (image ? ") " : ", std430) ") +
           (image ? "" : kRights[static_cast<size_t>(bindings_[k]->access)]) + declared_[k].text;
  }
  return out + rest;
}

std::string Shader::functions_and_main() {
  std::string out;
  for (const std::string& p : preludes_) out += p;
  if (cut_) out += cut_->variables();
  for (const uint32_t resource : loaded_) out += load_function(schedule_.resources[resource], bound_.at(resource));
  for (const auto& [bound, function] : words_) {
    const std::string& word = declared_[bound.binding].word;
    const int texel = bindings_[bound.binding]->texel;
    const std::string fetch = "texelFetch(" + bound.name + ", index)";
    out += word + " " + function + "(int index) { return " +
           (texel == 0   ? bound.name + ".d[index]"
            : texel == 1 ? fetch + ".x"
                         : "wide_of(" + fetch + ".xy)") +
           "; }\n";
  }
  out += declarations_;
  if (cut_) out += cut_->functions();
  const bool together = !together_at_end_.empty();
  out += together ? "\nvoid compute() {\n" : "\nvoid main() {\n";
  out += body_.take();
  out += "}\n";
  if (together) out += "\nvoid main() {\n  compute();\n" + together_at_end_ + "}\n";
  return out;
}

}  // namespace dr::backend::glsl
