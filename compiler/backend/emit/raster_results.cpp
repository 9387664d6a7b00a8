// SPDX-License-Identifier: Apache-2.0
// What the walks of a raster leave in memory, taken apart into its results, or put together as entries.
#include <algorithm>

#include "compiler/backend/emit/raster_closures.h"

namespace dr::backend {

using glsl::dim_expression;
using glsl::Shader;
using ir::Dim;
using ir::ValueId;

// So many ranks a dispatch, which binds two buffers for each.
constexpr size_t kRanks = 8;

// Takes faces, tags and orders out of the entries of 64 bits that the walks left.
void Generator::take_out(const Pass& pass, const ir::Op& op, uint32_t slots) {
  const RasterParts parts = raster_parts(op);
  const Dim pixels = element_count(parts.extent());
  const std::string n = dim_expression(pixels);
  for (size_t begin = 0; begin < parts.count; begin += kRanks) {
    Shader r = strict_shader();
    wide_extensions(r);
    linear_index(r, n);
    place_from_index(r, parts.extent());
    const std::string read = r.read_words(slots, "slots", "uint64_t");
    for (size_t k = begin; k < std::min(begin + kRanks, parts.count); ++k) {
      const std::string rank = std::to_string(k), entry = "entry_" + rank, none = "none_" + rank;
      const ValueId* const results = &op.results[parts.each * k];
      r.body().line("uint64_t " + entry + " = " + read + "(" + rank + " * " + n + " + index);");
      r.body().line("bool " + none + " = " + entry + " == 0xfffffffffffffffful;");
      r.store(results[0], "at", "(" + none + " ? -1 : int(uint((" + entry + " >> 4) & 0xfffffffful)))");
      r.store(results[1], "at", "(" + none + " ? 0 : int(" + entry + " & 15ul))");
      if (parts.each == 3) r.store(results[2], "at", "int(uint(" + entry + " >> 36) & 0xffffffu)");
    }
    dispatch(pass, "_resolve", r, pixels.str());
  }
}

// The walks in two rounds of 32 bits leave keys and faces: tags are computed here, and all stored, as entries where
// they `stay` such.
void Generator::resolve(const Pass& pass, const ir::Op& op, uint32_t keys, uint32_t ids, bool stay) {
  const RasterParts parts = raster_parts(op);
  const Dim pixels = element_count(parts.extent());
  const std::string n = dim_expression(pixels);
  // A tag that is the same for all faces is computed of nothing.
  const ir::ValueInfo& info = graph_.value(graph_.region(op.regions[kTag]).yields[0]);
  const bool constant = info.op.valid() && graph_.op(info.op).kind == ir::OpKind::Const;
  const auto find = [&](Shader& r, const std::string& read, const std::string& at, const std::string& face,
                        const std::string& tag) {
    r.body().line("int " + face + " = int(" + read + "(" + at + "));");
    r.body().line("int " + tag + " = 0;");
    r.body().line("if (" + face + " >= 0) {");
    r.push_scope();
    RasterClosures tags(r, graph_, pass, op);
    if (!constant) {
      tags.load_fields("ivec3(" + face + ", 0, at.z)", {kTag});
      tags.captured();
    }
    const std::string found = constant ? glsl::literal(ir::kInt, graph_.op(info.op).attrs.floats) : tags.closure(kTag);
    r.body().line(tag + " = " + found + " & 15;");
    r.pop_scope();
    r.body().line("}");
  };
  if (stay) {
    // An invocation has one pixel of one rank: SwiftShader takes many times as long over branches inside a loop.
    const Dim all = pixels * Dim(static_cast<int64_t>(parts.count));
    Shader r = strict_shader();
    linear_index(r, dim_expression(all));
    r.body().line("int rank = index / (" + n + "), pixel = index - rank * (" + n + ");");
    place_from_index(r, parts.extent(), "pixel");
    r.body().line("vec2 p = vec2(at.xy) + 0.5;");
    find(r, r.read_words(ids, "faces"), "index", "face", "tag");
    const std::string entries = r.bind_words(resource_index(op.results[0]), "entries", bundle::Access::Write, "uvec2");
    const std::string key = parts.each == 3 ? "(" + r.read_words(keys, "keys") + "(index) << 4) | " : "";
    r.body().line(entries + ".d[index] = face < 0 ? uvec2(0xffffffffu) : " + "uvec2((uint(face) << 4) | uint(tag), " +
                  key + "uint(face) >> 28);");
    dispatch(pass, "_resolve", r, all.str());
    return;
  }
  for (size_t begin = 0; begin < parts.count; begin += kRanks) {
    Shader r = strict_shader();
    linear_index(r, n);
    place_from_index(r, parts.extent());
    const std::string read = r.read_words(ids, "faces");
    r.body().line("vec2 p = vec2(at.xy) + 0.5;");
    for (size_t k = begin; k < std::min(begin + kRanks, parts.count); ++k) {
      const std::string rank = std::to_string(k), face = "face_" + rank, tag = "tag_" + rank;
      const std::string entry = rank + " * " + n + " + index";
      const ValueId* const results = &op.results[parts.each * k];
      find(r, read, entry, face, tag);
      r.store(results[0], "at", face);
      r.store(results[1], "at", tag);
      if (parts.each == 3)
        r.store(results[2], "at", "int(" + r.read_words(keys, "keys") + "(" + entry + ") & 0xffffffu)");
    }
    dispatch(pass, "_resolve", r, pixels.str());
  }
}

}  // namespace dr::backend
