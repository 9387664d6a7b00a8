// SPDX-License-Identifier: Apache-2.0
// Raster passes: draws that propose and a fragment shader that decides, peeled K times; or compute shaders that loop
// over each face's box. All keep exactly the pixels whose centre `keep` accepts, ordered by (key, face).
#include "compiler/backend/generate.h"

namespace dr::backend {

using glsl::dim_expression;
using glsl::Shader;
using ir::Dim;
using ir::Extent;
using ir::ValueId;

namespace {

enum RegionIndex : size_t { kDepth, kKeep, kTag };

struct Parts {
  size_t count;  // K
  std::vector<ValueId> fields, corners;
  ValueId cull;
  Dim w, h, l, faces;
  Extent extent() const { return {w, h, l}; }
};

Parts parts_of(const ir::Op& op) {
  Parts p;
  p.count = static_cast<size_t>(op.attrs.ints[0]);
  const auto fields = static_cast<size_t>(op.attrs.ints[1]), corners = static_cast<size_t>(op.attrs.ints[2]);
  p.fields.assign(op.operands.begin(), op.operands.begin() + static_cast<ptrdiff_t>(fields));
  p.corners.assign(op.operands.begin() + static_cast<ptrdiff_t>(fields),
                   op.operands.begin() + static_cast<ptrdiff_t>(fields + corners));
  p.cull = op.operands.back();
  p.w = op.attrs.dims[0];
  p.h = op.attrs.dims[1];
  p.l = op.attrs.dims[2];
  p.faces = op.attrs.dims[3];
  return p;
}

constexpr const char* kIsNan = R"(
bool dr_no_number(float x) { return (floatBitsToUint(x) & 0x7fffffffu) > 0x7f800000u; }
bool dr_no_number(vec2 x) { return dr_no_number(x.x) || dr_no_number(x.y); }
)";

// Corners moved outwards by a pixel, because devices snap corners to a grid of 1/16 to 1/256 of a pixel. Where that
// would make a long spike, or coordinates are huge, the triangle that covers the box around the hull proposes instead.
constexpr const char* kGrow = R"(
vec2 grown_corner(vec2 a, vec2 b, vec2 c, int k, vec2 size) {
  vec2 low = clamp(min(a, min(b, c)), vec2(-2.0), size + 2.0) - 1.0;
  vec2 high = clamp(max(a, max(b, c)), vec2(-2.0), size + 2.0) + 1.0;
  vec2 v[3] = vec2[3](a, b, c);
  vec2 away[3];
  float turn = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
  bool fine = abs(turn) > 0.01 && all(lessThan(abs(a), vec2(16000.0))) && all(lessThan(abs(b), vec2(16000.0))) && all(lessThan(abs(c), vec2(16000.0)));
  for (int i = 0; i < 3 && fine; ++i) {
    vec2 before = normalize(v[i] - v[(i + 2) % 3]) * sign(turn);
    vec2 after = normalize(v[(i + 1) % 3] - v[i]) * sign(turn);
    vec2 outward = vec2(before.y, -before.x) + vec2(after.y, -after.x);
    float spread = 1.0 + dot(before, after);
    if (spread < 0.2) fine = false;
    away[i] = outward / spread;
  }
  if (fine) return v[k] + away[k];
  if (k == 0) return low;
  return k == 1 ? vec2(low.x + 2.0 * (high.x - low.x), low.y) : vec2(low.x, low.y + 2.0 * (high.y - low.y));
}
)";

}  // namespace

void Generator::raster_pass(const Pass& pass) {
  const ir::Op& op = graph_.op(pass.ops.back());
  if (pass.hardware)
    raster_hardware(pass, op);
  else
    raster_compute(pass, op);
}

namespace {

// Emits what the closures share, for the element at `at` and the face `face`.
class Closures {
 public:
  Closures(Shader& shader, const ir::Graph& graph, const Pass& pass, const ir::Op& op)
      : shader_(shader), graph_(graph), pass_(pass), op_(op), parts_(parts_of(op)) {}

  // A value of the record; `place` names the face and layer.
  std::string record(ValueId value, const std::string& place) {
    const ir::Op& def = graph_.op(graph_.value(value).op);
    return def.kind == ir::OpKind::Const ? glsl::literal(graph_.value(value).type, def.attrs.floats)
                                         : shader_.load(value, place);
  }
  // Loads the fields once, for all three closures.
  void load_fields(const std::string& place) {
    for (size_t k = 0; k < parts_.fields.size(); ++k) {
      const std::string name = shader_.unique("field");
      shader_.body().line(graph_.value(parts_.fields[k]).type.str() + " " + name + " = " +
                          record(parts_.fields[k], place) + ";");
      fields_.push_back(name);
    }
  }
  // What the closures capture and is recomputed here.
  void captured() { shader_.element_ops({pass_.ops.begin(), pass_.ops.end() - 1}); }
  std::string closure(RegionIndex which) {
    const ir::Region& region = graph_.region(op_.regions[which]);
    for (size_t k = 0; k < fields_.size(); ++k) shader_.define(region.params[k], fields_[k]);
    shader_.define(region.params[fields_.size()], "p");
    return shader_.region(op_.regions[which])[0];
  }
  void key_from_depth() {
    const std::string depth = closure(kDepth);
    shader_.body().line("uint key = uint(floor(clamp(" + depth + ", 0.0, 1.0) * 16777215.0));");
    shader_.body().line("bool no_depth = dr_no_number(" + depth + ");");
  }

 private:
  Shader& shader_;
  const ir::Graph& graph_;
  const Pass& pass_;
  const ir::Op& op_;
  Parts parts_;
  std::vector<std::string> fields_;
};

}  // namespace

void Generator::raster_hardware(const Pass& pass, const ir::Op& op) {
  const Parts parts = parts_of(op);
  const std::string w = dim_expression(parts.w), h = dim_expression(parts.h);

  auto add_image = [&](const std::string& name, bundle::Storage storage, const ir::Type& type) {
    auto out = std::make_unique<bundle::ResourceT>();
    out->name = name;
    out->storage = storage;
    out->role = bundle::Role::Value;
    out->type = bundle_type(type);
    out->extent = bundle_extent(parts.extent());
    bundle_->resources.push_back(std::move(out));
    return static_cast<uint32_t>(bundle_->resources.size() - 1);
  };
  const uint32_t depth = add_image(pass.name + "_depth", bundle::Storage::Depth, ir::kFloat);
  std::vector<uint32_t> keys;
  for (size_t k = 0; k < parts.count; ++k)
    keys.push_back(add_image(pass.name + "_key_" + std::to_string(k), bundle::Storage::Image, ir::kUint));

  for (size_t k = 0; k < parts.count; ++k) {
    // Both stages bind one set: what the vertex stage reads comes first in both.
    const auto bind_corners = [&](Shader& s) {
      for (const ValueId value : parts.corners)
        if (step_->stored.count(value) != 0) s.load(value, "at");
      if (step_->stored.count(parts.cull) != 0) s.load(parts.cull, "at");
    };
    Shader v = shader();
    bind_corners(v);
    v.prelude(kIsNan);
    v.prelude(kGrow);
    v.declare("layout(location = 0) flat out int out_face;\n");
    const auto triangles = parts.corners.size() / 3;
    v.body().line("int triangle = gl_VertexIndex / 3;");
    v.body().line("int face = triangle / " + std::to_string(triangles) + ";");
    v.body().line("ivec3 at = ivec3(face, 0, pc.layer);");
    v.body().line("vec2 size = vec2(" + w + ", " + h + ");");
    Closures corner(v, graph_, pass, op);
    v.body().line("vec2 corners[" + std::to_string(parts.corners.size()) + "];");
    v.body().line("bool dropped = " + corner.record(parts.cull, "at") + ";");
    for (size_t c = 0; c < parts.corners.size(); ++c) {
      const std::string name = "corners[" + std::to_string(c) + "]";
      v.body().line(name + " = " + corner.record(parts.corners[c], "at") + ";");
      v.body().line("dropped = dropped || dr_no_number(" + name + ");");
    }
    v.body().line("int first = 3 * (triangle % " + std::to_string(triangles) + ");");
    v.body().line(
        "vec2 p = grown_corner(corners[first], corners[first + 1], corners[first + 2], gl_VertexIndex % 3, size);");
    v.body().line("if (dropped) p = vec2(-4.0) * size;");
    v.body().line("out_face = face;");
    v.body().line("gl_Position = vec4(p / size * 2.0 - 1.0, 0.5, 1.0);");

    Shader f = shader();
    f.prelude(kIsNan);
    f.declare("layout(location = 0) flat in int in_face;\n");
    f.declare(
        "layout(location = 0) out int out_face;\nlayout(location = 1) out int out_tag;\nlayout(location = 2) out uint "
        "out_key;\n");
    bind_corners(f);
    Closures closures(f, graph_, pass, op);
    f.body().line("int face = in_face;");
    f.body().line("ivec3 at = ivec3(ivec2(gl_FragCoord.xy), pc.layer);");
    f.body().line("vec2 p = vec2(at.xy) + 0.5;");
    closures.load_fields("ivec3(face, 0, at.z)");
    closures.captured();
    f.body().line("if (!" + closures.closure(kKeep) + ") discard;");
    closures.key_from_depth();
    f.body().line("if (no_depth) discard;");
    if (k > 0) {
      const std::string key = f.bind_image(keys[k - 1], "previous_key", "u");
      const std::string face = f.bind(step_->stored.at(op.results[2 * (k - 1)]), bundle::Access::Read);
      f.body().line("uint previous_key_here = texelFetch(" + key + ", at, 0).x;");
      f.body().line("int previous_face_here = texelFetch(" + face + ", at, 0).x;");
      f.body().line(
          "if (key < previous_key_here || (key == previous_key_here && face <= previous_face_here)) discard;");
    }
    f.body().line("out_face = face;");
    f.body().line("out_tag = " + closures.closure(kTag) + " & 15;");
    f.body().line("out_key = key;");
    f.body().line("gl_FragDepth = float(key) / 16777216.0;");

    const std::string name = pass.name + "_" + std::to_string(k);
    auto& c = command(bundle::CommandKind::Draw, name);
    c.vertex = add_shader(pass.name + "_corners", bundle::Stage::Vertex, v.finish(""));
    c.fragment = add_shader(name, bundle::Stage::Fragment, f.finish(""));
    c.bindings = f.take_bindings();
    const auto own = v.take_bindings();
    for (size_t b = 0; b < own.size(); ++b)
      DR_ASSERT(b < c.bindings.size() && own[b]->resource == c.bindings[b]->resource);
    c.elements = (parts.faces * Dim(static_cast<int64_t>(parts.corners.size()))).str();
    c.extent = bundle_extent(parts.extent());
    c.colors = {resource_index(op.results[2 * k]), resource_index(op.results[2 * k + 1]), keys[k]};
    c.clear = {0xffffffffu, 0u, 0xffffffffu};
    c.depth = static_cast<int>(depth);
    c.push = {0, 0, 0};
  }
}

void Generator::raster_compute(const Pass& pass, const ir::Op& op) {
  const Parts parts = parts_of(op);
  const std::string w = dim_expression(parts.w), h = dim_expression(parts.h), faces = dim_expression(parts.faces);
  const Dim pixels = element_count(parts.extent());
  const Dim slots = pixels * Dim(static_cast<int64_t>(parts.count));
  const bool wide = wide_atomics();
  const char* const word = wide ? "uint64_t" : "uint";
  const uint32_t keys = add_scratch(pass.name + (wide ? "_slots" : "_keys"), (wide ? slots * Dim(2) : slots).str());
  const uint32_t ids = wide ? keys : add_scratch(pass.name + "_faces", slots.str());
  fill("clear " + pass.name, keys, 0xffffffffu);
  if (!wide) fill("clear " + pass.name + " faces", ids, 0xffffffffu);
  const std::string n = dim_expression(pixels);

  // One invocation a face and layer walks the box around the hull.
  Shader s = shader();
  if (wide) wide_extensions(s);
  s.prelude(kIsNan);
  Closures closures(s, graph_, pass, op);
  linear_index(s, dim_expression(parts.faces * parts.l));
  s.body().line("int face = index % " + faces + ";");
  s.body().line("ivec3 at = ivec3(face, 0, index / " + faces + ");");
  s.body().line("if (" + closures.record(parts.cull, "at") + ") return;");
  s.body().line("vec2 low = vec2(uintBitsToFloat(0x7f800000u)), high = -low, corner;");
  for (const ValueId value : parts.corners) {
    s.body().line("corner = " + closures.record(value, "at") + ";");
    s.body().line("if (dr_no_number(corner)) return;");
    s.body().line("low = min(low, corner);");
    s.body().line("high = max(high, corner);");
  }
  s.body().line("vec2 size = vec2(" + w + ", " + h + ");");
  s.body().line("ivec2 first = ivec2(clamp(floor(low) - 1.0, vec2(0.0), size));");
  s.body().line("ivec2 last = ivec2(clamp(ceil(high) + 1.0, vec2(0.0), size));");
  closures.load_fields("at");
  s.body().line("for (at.y = first.y; at.y < last.y; ++at.y)");
  s.body().line("for (at.x = first.x; at.x < last.x; ++at.x) {");
  s.push_scope();
  s.body().line("vec2 p = vec2(at.xy) + 0.5;");
  closures.captured();
  s.body().line("if (!" + closures.closure(kKeep) + ") continue;");
  closures.key_from_depth();
  s.body().line("if (no_depth) continue;");
  s.body().line("int pixel = (at.z * " + h + " + at.y) * " + w + " + at.x;");
  const std::string key_words = s.bind_words(keys, wide ? "slots" : "keys", bundle::Access::ReadWrite, word);
  if (wide) {
    s.body().line("uint64_t entry = (uint64_t(key) << 36) | (uint64_t(uint(face)) << 4) | uint64_t(" +
                  closures.closure(kTag) + " & 15);");
    // Each slot keeps the smaller entry and hands the other on, so that the K smallest end up sorted whatever the
    // order.
    s.body().line("for (int k = 0; k < " + std::to_string(parts.count) + "; ++k) {");
    s.body().line("uint64_t old = atomicMin(" + key_words + ".d[k * " + n + " + pixel], entry);");
    s.body().line("entry = max(old, entry);");
    s.body().line("}");
  } else {
    // Peeling: pc.a is the rank; first the least key beyond the rank before, then the least face with it.
    const std::string id_words = s.bind_words(ids, "faces", bundle::Access::ReadWrite);
    s.body().line("int slot = pc.a * " + n + " + pixel;");
    s.body().line("if (pc.a > 0) {");
    s.body().line("uint before = " + key_words + ".d[slot - " + n + "];");
    s.body().line("if (key < before || (key == before && uint(face) <= " + id_words + ".d[slot - " + n +
                  "])) continue;");
    s.body().line("}");
    s.body().line("if (pc.b == 0) atomicMin(" + key_words + ".d[slot], key);");
    s.body().line("else if (" + key_words + ".d[slot] == key) atomicMin(" + id_words + ".d[slot], uint(face));");
  }
  s.pop_scope();
  s.body().line("}");
  auto& rank0 = dispatch(pass, "_faces", s, (parts.faces * parts.l).str());
  if (!wide)
    for (int run = 1; run < 2 * static_cast<int>(parts.count); ++run) {
      auto& c = command(bundle::CommandKind::Dispatch, pass.name + "_faces");
      c.compute = rank0.compute;
      for (const auto& b : rank0.bindings) c.bindings.push_back(std::make_unique<bundle::BindingT>(*b));
      c.elements = rank0.elements;
      c.push = {run / 2, run % 2, 0};
    }

  Shader r = shader();
  if (wide) wide_extensions(r);
  linear_index(r, n);
  place_from_index(r, parts.extent());
  const std::string in_keys = r.bind_words(keys, wide ? "slots" : "keys", bundle::Access::Read, word);
  if (wide) {
    for (size_t k = 0; k < parts.count; ++k) {
      const std::string rank = std::to_string(k);
      r.body().line("uint64_t entry_" + rank + " = " + in_keys + ".d[" + rank + " * " + n + " + index];");
      r.body().line("bool none_" + rank + " = entry_" + rank + " == 0xfffffffffffffffful;");
      r.store(op.results[2 * k], "at",
              "(none_" + rank + " ? -1 : int(uint((entry_" + rank + " >> 4) & 0xfffffffful)))");
      r.store(op.results[2 * k + 1], "at", "(none_" + rank + " ? 0 : int(entry_" + rank + " & 15ul))");
    }
  } else {
    const std::string in_ids = r.bind_words(ids, "faces", bundle::Access::Read);
    r.body().line("vec2 p = vec2(at.xy) + 0.5;");
    for (size_t k = 0; k < parts.count; ++k) {
      const std::string rank = std::to_string(k);
      r.body().line("int face_" + rank + " = int(" + in_ids + ".d[" + rank + " * " + n + " + index]);");
      r.body().line("int tag_" + rank + " = 0;");
      r.body().line("if (face_" + rank + " >= 0) {");
      r.push_scope();
      Closures tags(r, graph_, pass, op);
      tags.load_fields("ivec3(face_" + rank + ", 0, at.z)");
      tags.captured();
      r.body().line("tag_" + rank + " = " + tags.closure(kTag) + " & 15;");
      r.pop_scope();
      r.body().line("}");
      r.store(op.results[2 * k], "at", "face_" + rank);
      r.store(op.results[2 * k + 1], "at", "tag_" + rank);
    }
  }
  dispatch(pass, "_resolve", r, pixels.str());
}

}  // namespace dr::backend
