// SPDX-License-Identifier: Apache-2.0
// Raster passes by draws: they propose and a fragment shader decides, peeled K times. Compute shaders that loop over
// each face's box stand in raster_compute.cpp. All keep exactly the pixels whose centre `keep` accepts,
// ordered by (key, face).
#include "compiler/backend/emit/raster_closures.h"

namespace dr::backend {

using glsl::dim_expression;
using glsl::Shader;
using ir::Dim;
using ir::ValueId;

namespace {

// Corners moved outwards by a pixel, because devices snap corners to a grid of 1/16 to 1/256 of a pixel. Where that
// would make spikes of more area than the triangle that covers the box around the hull, or coordinates are huge, the
// latter proposes instead.
constexpr const char* kGrow = R"(
vec2 grown_corner(vec2 a, vec2 b, vec2 c, int k, vec2 size) {
  vec2 low = clamp(min(a, min(b, c)), vec2(-2.0), size + 2.0) - 1.0;
  vec2 high = clamp(max(a, max(b, c)), vec2(-2.0), size + 2.0) + 1.0;
  vec2 v[3] = vec2[3](a, b, c);
  vec2 away[3];
  float turn = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
  float around = distance(a, b) + distance(b, c) + distance(c, a), larger = 1.0 + around / abs(turn);
  bool fine = abs(turn) > 0.01 && larger * larger * abs(turn) < 4.0 * (high.x - low.x) * (high.y - low.y) && all(lessThan(abs(a), vec2(16000.0))) && all(lessThan(abs(b), vec2(16000.0))) && all(lessThan(abs(c), vec2(16000.0)));
  for (int i = 0; i < 3 && fine; ++i) {
    vec2 before = normalize(v[i] - v[(i + 2) % 3]) * sign(turn);
    vec2 after = normalize(v[(i + 1) % 3] - v[i]) * sign(turn);
    vec2 outward = vec2(before.y, -before.x) + vec2(after.y, -after.x);
    float spread = 1.0 + dot(before, after);
    if (spread < 0.0005) fine = false;
    away[i] = outward / spread;
  }
  if (fine) return v[k] + away[k];
  if (k == 0) return low;
  return k == 1 ? vec2(low.x + 2.0 * (high.x - low.x), low.y) : vec2(low.x, low.y + 2.0 * (high.y - low.y));
}
)";

}  // namespace

void Generator::raster_hardware(const Pass& pass, const ir::Op& op) {
  const RasterParts parts = raster_parts(op);
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
  // The orders are the keys, where they are results.
  const bool ordered = parts.each == 3;
  std::vector<uint32_t> keys;
  for (size_t k = 0; k < parts.count; ++k)
    keys.push_back(ordered ? resource_index(op.results[parts.each * k + 2])
                           : add_image(pass.name + "_key_" + std::to_string(k), bundle::Storage::Image, ir::kUint));

  for (size_t k = 0; k < parts.count; ++k) {
    // Both stages bind one set: what the vertex stage reads comes first in both.
    const auto bind_corners = [&](Shader& s) {
      for (const ValueId value : parts.corners)
        if (step_->stored.count(value) != 0) s.load(value, "at");
      if (step_->stored.count(parts.cull) != 0) s.load(parts.cull, "at");
    };
    Shader v = strict_shader();
    bind_corners(v);
    v.prelude(kIsNan);
    v.prelude(kGrow);
    v.declare("layout(location = 0) flat out int out_face;\n");
    const auto triangles = parts.corners.size() / 3;
    v.body().line("int triangle = gl_VertexIndex / 3;");
    v.body().line("int face = triangle / " + std::to_string(triangles) + ";");
    v.body().line("ivec3 at = ivec3(face, 0, " + drawn_layer(v, parts.l) + ");");
    v.body().line("vec2 size = vec2(" + w + ", " + h + ");");
    RasterClosures corner(v, graph_, pass, op);
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

    Shader f = strict_shader();
    f.prelude(kIsNan);
    f.declare("layout(location = 0) flat in int in_face;\n");
    f.declare("layout(location = 0) out int out_face;\nlayout(location = 1) out int out_tag;\n");
    f.declare(std::string("layout(location = 2) out ") + (ordered ? "int" : "uint") + " out_key;\n");
    bind_corners(f);
    RasterClosures closures(f, graph_, pass, op);
    f.body().line("int face = in_face;");
    f.body().line("ivec3 at = ivec3(ivec2(gl_FragCoord.xy), " + drawn_layer(f, parts.l) + ");");
    f.body().line("vec2 p = vec2(at.xy) + 0.5;");
    closures.load_fields("ivec3(face, 0, at.z)", {kDepth, kKeep, kTag});
    closures.begin_candidates(false);
    closures.captured();
    closures.leave_unless_kept("discard");
    closures.key_from_depth("discard");
    if (k > 0) {
      const std::string key = f.bind_image(keys[k - 1], "previous_key", ordered ? "i" : "u");
      const std::string face = f.bind(step_->stored.at(op.results[parts.each * (k - 1)]), bundle::Access::Read);
      f.body().line("uint previous_key_here = " +
                    (ordered ? "uint(texelFetch(" + key + ", at, 0).x);" : "texelFetch(" + key + ", at, 0).x;"));
      f.body().line("int previous_face_here = texelFetch(" + face + ", at, 0).x;");
      if (ordered) f.body().line("if (previous_face_here < 0) discard;");
      f.body().line(
          "if (key < previous_key_here || (key == previous_key_here && face <= previous_face_here)) discard;");
    }
    f.body().line("out_face = face;");
    f.body().line("out_tag = " + closures.closure(kTag) + " & 15;");
    closures.end_of_candidates();
    f.body().line(ordered ? "out_key = int(key);" : "out_key = key;");
    f.body().line("gl_FragDepth = float(key) / 16777216.0;");

    const std::string name = pass.name + "_" + std::to_string(k);
    auto& c = command(bundle::CommandKind::Draw, name);
    c.vertex = add_shader(pass.name + "_corners", bundle::Stage::Vertex, v);
    c.fragment = add_shader(name, bundle::Stage::Fragment, f);
    c.bindings = f.take_bindings();
    const auto own = v.take_bindings();
    for (size_t b = 0; b < own.size(); ++b)
      DR_ASSERT(b < c.bindings.size() && own[b]->resource == c.bindings[b]->resource);
    c.elements = (parts.faces * Dim(static_cast<int64_t>(parts.corners.size()))).str();
    c.extent = bundle_extent(parts.extent());
    const ValueId* const results = &op.results[parts.each * k];
    c.colors = {resource_index(results[0]), resource_index(results[1]), keys[k]};
    c.clear = {0xffffffffu, 0u, ordered ? static_cast<uint32_t>(ir::kLastOrder) : 0xffffffffu};
    c.depth = static_cast<int>(depth);
    c.push = {0, 0, 0};
  }
}

}  // namespace dr::backend
