// SPDX-License-Identifier: Apache-2.0
// What a generated shader binds, loads and stores.
#include <algorithm>

#include "compiler/backend/bundle/entries.h"
#include "compiler/backend/glsl/shader.h"
#include "compiler/ops/prelude.h"

namespace dr::backend::glsl {

using ir::Extent;
using ir::Type;
using ir::ValueId;

namespace {

// An element of a buffer, which starts at word `base`, or at that texel of `texel` components.
std::string from_buffer(const Type& type, const std::string& buffer, int texel) {
  static const char* const kSwizzle[] = {".x", ".xy", ".xyz", ""};
  const int step = std::max(texel, 1), parts = type.components() / step;
  std::string out;
  for (int k = 0; k < parts; ++k) {
    const std::string index = k ? "base + " + std::to_string(k) : "base";
    out += (k ? ", " : "") + (texel == 0 ? buffer + ".d[" + index + "]"
                                         : "texelFetch(" + buffer + ", " + index + ")" + kSwizzle[texel - 1]);
    if (type.is_bool() && step == 1) out += " != 0u";
  }
  return type.is_scalar() ? out : type.str() + "(" + out + ")";
}

// A vector out of `words`, two components in each.
std::string from_halves(const Type& type) {
  const bool one = type.components() <= 2;
  std::string out;
  for (int c = 0; c < type.components(); ++c)
    out += std::string(c ? ", " : "") + "dr_from_half(words" +
           (one     ? ""
            : c < 2 ? ".x"
                    : ".y") +
           (c % 2 ? " >> 16)" : ")");
  return type.str() + "(" + out + ")";
}

// Of an entry, see lowering/raster_entries.h. An empty one's face comes out as -1.
constexpr const char* kEntry = R"(
int face_of(uvec2 entry) { return int((entry.x >> 4) | (entry.y << 28)); }
int tag_of(uvec2 entry) { return entry.y == 0xffffffffu ? 0 : int(entry.x & 15u); }
)";
constexpr const char* kOrder = R"(
int order_of(uvec2 entry) { return int((entry.y >> 4) & 0xffffffu); }
)";

const char* word_of(ir::RasterResult what) {
  switch (what) {
    case ir::RasterResult::Face: return "face";
    case ir::RasterResult::Tag: return "tag";
    case ir::RasterResult::Order: break;
  }
  return "order";
}

// How many components one fetch can give of an element.
int texel_of(const Type& type) {
  for (const int most : {4, 3, 2})
    if (type.components() % most == 0) return most;
  return 1;
}

}  // namespace

const std::string* Shader::find_bound(uint32_t bundle_resource, bundle::Access access) {
  const auto it = bound_.find(bundle_resource);
  if (it == bound_.end()) return nullptr;
  bundle::Access& has = bindings_[it->second.binding]->access;
  if (has != access) has = bundle::Access::ReadWrite;
  return &it->second.name;
}

std::string Shader::add_binding(uint32_t bundle_resource, const std::string& name, bundle::Access access,
                                Declared declared) {
  bound_[bundle_resource] = {name, bindings_.size()};
  auto binding = std::make_unique<bundle::BindingT>();
  binding->resource = bundle_resource;
  binding->access = access;
  bindings_.push_back(std::move(binding));
  declared_.push_back(std::move(declared));
  return name;
}

std::string Shader::buffer(uint32_t bundle_resource, const std::string& name, bundle::Access access, const char* word,
                           int texel) {
  if (const std::string* bound = find_bound(bundle_resource, access)) return *bound;
  return add_binding(bundle_resource, name, access,
                     {"restrict buffer " + name + "_block { " + word + " d[]; } " + name + ";\n", texel, word});
}

std::string Shader::bind(ResourceId id, bundle::Access access) {
  if (const std::string* name = find_bound(id.index, access)) return *name;
  const Resource& r = schedule_.resources[id.index];
  const std::string name = "r_" + sanitize(r.name) + "_" + std::to_string(id.index);
  if (r.is(Resource::Storage::Image))
    return bind_image(id.index, name, r.type.is_float() ? "" : r.type.scalar == ir::Scalar::Int ? "i" : "u");
  if (r.is_entries()) return buffer(id.index, name, access, "uvec2", 2);
  if (r.is(Resource::Storage::Halves)) {
    prelude(ops::glsl::kHalf);
    return buffer(id.index, name, access, "uint", texel_of(ir::vec(r.words(), ir::Scalar::Uint)));
  }
  return buffer(id.index, name, access, storage_scalar(r.type.scalar).c_str(), texel_of(r.type));
}

std::string Shader::bind_words(uint32_t bundle_resource, const std::string& name, bundle::Access access,
                               const char* word) {
  return buffer(bundle_resource, name, access, word, 0);
}

std::string Shader::read_words(uint32_t bundle_resource, const std::string& name, const char* word) {
  const bool wide = std::string_view(word) == "uint64_t";
  buffer(bundle_resource, name, bundle::Access::Read, word, wide ? 2 : 1);
  std::string function = "word_of_" + name;
  if (functions_.insert(function).second) words_.push_back({bound_.at(bundle_resource), function});
  return function;
}

bool Shader::may_read_fours(ValueId value) const {
  const Resource& r = resource(value);
  return schedule_.code.texel_reads && r.type.is_scalar() &&
         (r.is(Resource::Storage::Buffer) || r.is(Resource::Storage::Leaf));
}

std::string Shader::read_fours(ValueId value) {
  DR_ASSERT(may_read_fours(value));
  const Resource& r = resource(value);
  const std::string name = bind(step_.stored.at(value), bundle::Access::Read);
  std::string function = "fours_of_" + name;
  declared_[bound_.at(step_.stored.at(value).index).binding].texel = 4;
  declare(ir::vec(4, r.type.scalar).str() + " " + function + "(int k) { return texelFetch(" + name + ", k); }\n");
  return function;
}

std::string Shader::bind_image(uint32_t bundle_resource, const std::string& name, const char* prefix) {
  if (const std::string* bound = find_bound(bundle_resource, bundle::Access::Read)) return *bound;
  extension("GL_EXT_samplerless_texture_functions");
  return add_binding(bundle_resource, name, bundle::Access::Read,
                     {std::string("uniform ") + prefix + "texture2DArray " + name + ";\n", 0, ""});
}

void Shader::read_as_input(ValueId value) {
  const Resource& r = resource(value);
  DR_ASSERT(!r.is_buffer());
  const uint32_t index = step_.stored.at(value).index;
  const std::string name = "r_" + sanitize(r.name) + "_" + std::to_string(index);
  const char* prefix = r.type.is_float() ? "" : r.type.scalar == ir::Scalar::Int ? "i" : "u";
  add_binding(index, name, bundle::Access::Read,
              {std::string("uniform ") + prefix + "subpassInput " + name + ";\n", 0, ""});
  inputs_.push_back(index);
}

std::vector<std::unique_ptr<bundle::BindingT>> Shader::take_bindings() { return std::move(bindings_); }

std::string Shader::element_index(const Extent& extent, const std::string& place) {
  std::string index;
  if (!extent.l.is_one()) index = place + ".z";
  if (!extent.h.is_one())
    index = index.empty() ? place + ".y" : "(" + index + " * " + dim_expression(extent.h) + " + " + place + ".y)";
  else if (!index.empty() && extent.w.is_one())
    return index;
  if (!extent.w.is_one())
    index = index.empty() ? place + ".x" : "(" + index + " * " + dim_expression(extent.w) + " + " + place + ".x)";
  return index.empty() ? "0" : index;
}

std::string Shader::in_range(const Extent& extent, const std::string& place) {
  return "all(greaterThanEqual(" + place + ", ivec3(0))) && all(lessThan(" + place + ", ivec3(" +
         dim_expression(extent.w) + ", " + dim_expression(extent.h) + ", " + dim_expression(extent.l) + ")))";
}

std::string Shader::load(ValueId value, const std::string& place) {
  const Resource& r = resource(value);
  const std::string function = "load_" + part_name(value);
  std::string call = function + "(" + place + ")";
  if (!functions_.insert(function).second) return call;
  if (r.is_sums() || r.is_emptied()) {
    const std::string text = sums_reader_(*this, value, function);
    declarations_ += text;
    return call;
  }
  const uint32_t index = step_.stored.at(value).index;
  const std::string whole = "load_" + bind(step_.stored.at(value), bundle::Access::Read).substr(2);
  if (whole == function || functions_.insert(whole).second) loaded_.push_back(index);
  if (is_bit(value)) {
    declarations_ += "int " + function + "(ivec3 at) { return ((" + whole +
                     "(ivec3(at.x >> 5, at.yz)) >> uint(at.x & 31)) & 1u) == 1u ? " +
                     std::to_string(bundle::kSomeFace) + " : -1; }\n";
    return call;
  }
  if (!r.is_entries()) return call;
  const RasterPart part = raster_part(graph_, value);
  const ir::Dim& layers = graph_.value(value).extent.l;
  prelude(part.what == ir::RasterResult::Order ? kOrder : kEntry);
  declarations_ += "int " + function + "(ivec3 at) { return " + word_of(part.what) + "_of(" + whole + "(ivec3(at.xy, " +
                   (layers.is_one() ? "0" : "at.z") + " + " + std::to_string(part.rank) + " * " +
                   dim_expression(layers) + "))); }\n";
  return call;
}

bool Shader::is_bit(ValueId value) const {
  return resource(value).is(Resource::Storage::Bits) && graph_.op(graph_.value(value).op).kind == ir::OpKind::Raster;
}

std::string Shader::part_name(ValueId value) const {
  const Resource& r = resource(value);
  std::string name = sanitize(r.name) + "_" + std::to_string(step_.stored.at(value).index);
  if (is_bit(value)) return name + "_bit";
  if (!r.is_entries()) return name;
  const RasterPart part = raster_part(graph_, value);
  return name + "_" + word_of(part.what) + "_" + std::to_string(part.rank);
}

std::string Shader::load_function(const Resource& r, const Bound& bound) const {
  const std::string& name = bound.name;
  std::string text = r.type.str() + " load_" + name.substr(2) + "(ivec3 at) {\n";
  if (!r.is_buffer()) {
    const bool input = std::find(inputs_.begin(), inputs_.end(), bindings_[bound.binding]->resource) != inputs_.end();
    const std::string fetch = input ? "subpassLoad(" + name + ")"
                                    : "texelFetch(" + name + ", ivec3(" + (r.extent.w.is_one() ? "0" : "at.x") + ", " +
                                          (r.extent.h.is_one() ? "0" : "at.y") + ", " +
                                          (r.extent.l.is_one() ? "0" : "at.z") + "), 0)";
    static const char* const kSwizzle[] = {".x", ".xy", ".xyz", ""};
    const std::string texel = fetch + kSwizzle[r.type.rows - 1];
    text += "  return " + (r.type.is_bool() ? r.type.str() + "(" + texel + ")" : texel) + ";\n";
  } else {
    const int texel = bindings_[bound.binding]->texel;
    if (r.is_entries()) {
      const auto element = [&](const std::string& index) {
        return texel == 0 ? name + ".d[" + index + "]" : "texelFetch(" + name + ", " + index + ").xy";
      };
      const std::string entry = element(element_index(r.extent, "at"));
      if (r.is(Resource::Storage::Entries)) return text + "  return " + entry + ";\n}\n";
      const std::string epoch = element(dim_expression(r.extent.w * r.extent.h * r.extent.l)) + ".x";
      return text + "  uvec2 entry = " + entry + ";\n  return entry.y >> 28 == " + epoch +
             " ? entry : uvec2(0xffffffffu);\n}\n";
    }
    const int parts = r.words() / std::max(texel, 1);
    text += "  int base = " + element_index(r.extent, "at") + (parts == 1 ? "" : " * " + std::to_string(parts)) + ";\n";
    const bool halves = r.is(Resource::Storage::Halves);
    const Type words = halves ? ir::vec(r.words(), ir::Scalar::Uint) : r.type;
    const std::string found = from_buffer(words, name, texel);
    text += halves ? "  " + words.str() + " words = " + found + ";\n  return " + from_halves(r.type) + ";\n"
                   : "  return " + found + (r.is(Resource::Storage::StepIndex) ? " - 1" : "") + ";\n";
  }
  return text + "}\n";
}

std::string Shader::gather(ValueId value, const std::string& place) {
  const ir::ValueInfo& info = graph_.value(value);
  load(value, "at");
  const std::string name = part_name(value);
  if (functions_.insert("gather_" + name).second) {
    const std::string type = info.type.str(), inside = in_range(info.extent, "at"), read = "load_" + name + "(at)";
    declarations_ += type + " gather_" + name + "(ivec3 at) {\n" +
                     (schedule_.code.no_else ? "  " + type + " x = " + zero(info.type) + ";\n  if (" + inside +
                                                   ") x = " + read + ";\n  return x"
                                             : "  return " + inside + " ? " + read + " : " + zero(info.type)) +
                     ";\n}\n";
  }
  return "gather_" + name + "(" + place + ")";
}

// LLVM would move the arithmetic before a store into the loop over lanes that llvmpipe makes of it; not through a
// choice that it cannot foresee (pc.c is 0 always).
std::string Shader::at_once(const Type& type, const std::string& expression) const {
  return schedule_.code.hidden_stores ? "(pushed_zero == 0 ? " + expression + " : " + zero(type) + ")" : expression;
}

void Shader::store(ValueId value, const std::string& place, const std::string& expression) {
  const Resource& r = resource(value);
  const std::string name = bind(step_.stored.at(value), bundle::Access::Write);
  const int n = r.words();
  const auto word = [&](int k) {
    if (r.is(Resource::Storage::Halves)) {
      const auto half = [&](int c) { return "dr_half_bits(" + component(r.type, expression, c) + ")"; };
      const bool two = 2 * k + 1 < r.type.components();
      return at_once(ir::kUint, two ? "(" + half(2 * k) + " | (" + half(2 * k + 1) + " << 16))" : half(2 * k));
    }
    const std::string all = at_once({r.type.scalar, 1, 1}, n == 1 ? expression : component(r.type, expression, k));
    return r.type.is_bool() ? "uint(" + all + ")" : all;
  };
  if (n == 1) {
    body_.line(name + ".d[" + element_index(r.extent, place) + "] = " + word(0) + ";");
    return;
  }
  const std::string base = unique("base");
  body_.line("int " + base + " = " + element_index(r.extent, place) + " * " + std::to_string(n) + ";");
  for (int c = 0; c < n; ++c)
    body_.line(name + ".d[" + base + (c ? " + " + std::to_string(c) : "") + "] = " + word(c) + ";");
}

}  // namespace dr::backend::glsl
