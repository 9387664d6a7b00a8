// SPDX-License-Identifier: Apache-2.0
// std.hardsoftras, std.coverage, std.raster and std.nvdiffrast: what they make of given fragments, and whole pictures
// of an icosphere. std.tiles, whose results are integers.
#include "tests/device/accuracy/library_table.h"

namespace dr::accuracy::library {

namespace {

constexpr double kFrame = 1e-4;  // for whole frames and their gradients
const std::string kCorners = "0 … 63";

// ---- Fragments that are given: sigma is 1, so that distances are arguments of the sigmoid ---------------------------

Operands distances() { return {floats("d0", -87, 87, 1e-6), floats("d1", -87, 20, 1e-6), floats("d2", -87, 20, 1e-6)}; }

const char* const kSoft =
    "  let f0 = hardsoftras.Fragment(0, false, ivec3(0), d0, vec3(0.0));\n"
    "  let f1 = hardsoftras.Fragment(1, false, ivec3(1), d1, vec3(0.0));\n"
    "  let f2 = hardsoftras.Fragment(2, false, ivec3(2), d2, vec3(0.0));\n"
    "  let soft = hardsoftras.Soft([f0, f1, f2], false, true, 1.0);\n";

std::vector<Function> of_fragments() {
  std::vector<Function> all;
  all.push_back({.name = "hardsoftras.silhouette",
                 .part = "of three",
                 .result = "float",
                 .operands = distances(),
                 .value = "hardsoftras.silhouette(soft)",
                 .directions = {relative("value", 1e-6, kBeforehand), relative("d0", 1e-6, kBeforehand),
                                relative("d1", 1e-6, kBeforehand), relative("d2", 1e-6, kBeforehand)},
                 .before = kSoft,
                 .domain = "in units of sigma"});
  const std::string largest = "max(max(abs(c0), abs(c1)), max(abs(c2), abs(behind)))";
  const std::string summed = "dot(abs(g), " + largest + ")";
  for (const char* form : {"over", "layer", "mean"}) {
    Operands operands = distances();
    for (const char* name : {"c0", "c1", "c2", "behind"}) operands.push_back(vectors(name, 0, 8, 1e-3));
    Directions directions = {over("value", 1e-6, largest, "the largest colour", kBeforehand)};
    for (const char* d : {"d0", "d1", "d2"})
      directions.push_back(over(d, 2e-6, summed, "the largest colour times |adjoint|", kBeforehand));
    for (const char* c : {"c0", "behind"}) directions.push_back(over(c, 1e-6, "length(g)", "|adjoint|", kBeforehand));
    all.push_back(
        {.name = "hardsoftras.blend",
         .part = form,
         .result = "vec3",
         .operands = operands,
         .value = std::string("hardsoftras.blend(soft, fn(s) { if s.corner.x == 0 { c0 } else if s.corner.x == 1 { "
                              "c1 } else { c2 } }, behind, form = hardsoftras.") +
                  form + ")",
         .directions = directions,
         .before = kSoft,
         .domain = "in units of sigma"});
  }
  // Points up to 32 pixels beside an edge.
  const Operand a = vectors("a", -2048, 2048, 1e-3, "vec2"), b = vectors("b", -2048, 2048, 1e-3, "vec2");
  const Operands points = {a,
                           b,
                           floats("t_", 0, 1, 1e-4),
                           floats("s_", -32, 32, 1e-4),
                           made("p", "vec2", "mix(a, b, t_) + s_ * normalize(vec2(a.y - b.y, b.x - a.x))"),
                           made("inside", "bool", "s_ >= 0.0")};
  const std::string size = "max(max(length(a), length(b)), length(p))";
  for (const bool straight : {true, false}) {
    const auto known = [](Direction d) {
      d.except = "abs(y) < 2.4e-7 * " + std::string("max(max(length(a), length(b)), length(p))");
      d.except_text = "distances that are all rounding";
      return d;
    };
    all.push_back(
        {.name = "hardsoftras.edge_distance",
         .part = straight ? "edge" : "corner",
         .result = "float",
         .operands = points,
         .value = std::string("hardsoftras.edge_distance(a, b, p, ") + (straight ? "true" : "false") + ", inside)",
         .directions = {
             over("value", 0x1p-22, size + " + distance(p, a) * distance(p, b) / distance(a, b)",
                  "the largest coordinate + |p - a| |p - b| / |b - a|",
                  "what the library promises: differences, products and a quotient; the bound set beforehand is half "
                  "of it"),
             known(over("p", 4 * u, "abs(g)", "|adjoint|", kBeforehand)),
             known(over("a", 8 * u, "abs(g) * (1.0 + distance(p, a) / distance(a, b))",
                        "|adjoint| (1 + |p - a| / |b - a|)", "the bound set beforehand, and where along the edge")),
             known(over("b", 8 * u, "abs(g) * (1.0 + distance(p, a) / distance(a, b))",
                        "|adjoint| (1 + |p - a| / |b - a|)", "the bound set beforehand, and where along the edge"))}});
    if (straight) continue;
    all.back().directions.pop_back();
    all.back().directions[0] = relative("value", 8 * u, kBeforehand);
  }
  // Interpolation by given weights.
  const Operand attribute = whole(vectors("attribute", -100, 100, 1e-3), "[64]");
  const Operand weight = vectors("w", 0, 1, 1e-6);
  const Operand corner = {.name = "i", .type = "ivec3", .low = 0, .high = 63};
  const Operand index = {.name = "index", .type = "ivec3", .low = 0, .high = 63, .extent = "[32]"};
  const Operand face = {.name = "f", .type = "int", .low = 0, .high = 31};
  const auto terms = [](const std::string& i) {
    return "abs(attribute.at(" + i + ".x)) * w.x + abs(attribute.at(" + i + ".y)) * w.y + abs(attribute.at(" + i +
           ".z)) * w.z";
  };
  const auto interpolation = [&](const std::string& name, const std::string& value, Operands operands,
                                 const std::string& i) {
    all.push_back({.name = name,
                   .part = {},
                   .result = "vec3",
                   .operands = join({{attribute, weight}, std::move(operands)}),
                   .value = value,
                   .directions = {over("value", 4 * u, terms(i), "the terms' sizes", kFew), relative("w", 2 * u, kFew),
                                  l2("attribute", 2e-7, "the bound set beforehand for sums")}});
  };
  const std::string fragment = "hardsoftras.Fragment(f, true, i, 0.0, w)", hit = "raster.Hit(f, i, w, w, w, 0.5)";
  interpolation("hardsoftras.interpolate",
                "hardsoftras.interpolate(hardsoftras.Fragment(0, true, i, 0.0, w), attribute)", {corner}, "i");
  interpolation("hardsoftras.interpolate_indexed",
                "hardsoftras.interpolate_indexed(hardsoftras.Fragment(f, true, ivec3(0), 0.0, w), attribute, index)",
                {face, index}, "index.at(f).xzy");
  for (const char* way : {"interpolate", "interpolate_dx", "interpolate_dy"})
    interpolation(std::string("raster.") + way,
                  std::string("raster.") + way + "(raster.Hit(0, i, w, w, w, 0.5), attribute)", {corner}, "i");
  interpolation("raster.interpolate_indexed",
                "raster.interpolate_indexed(raster.Hit(f, ivec3(0), w, w, w, 0.5), attribute, index)", {face, index},
                "index.at(f)");
  interpolation("nvdiffrast.interpolate",
                "nvdiffrast.interpolate(attribute, raster.Hit(f, ivec3(0), w, w, w, 0.5), index).0", {face, index},
                "index.at(f)");
  return all;
}

// ---- Whole pictures -------------------------------------------------------------------------------------------------

// An icosphere of 92 vertices and 180 faces in 64 x 64 pixels, from two sides; its vertices in clip space are the
// operand.
Operands scene(bool opengl) {
  const std::string lens = opengl ? "camera.to_opengl_clip(camera.perspective(40.0))" : "camera.perspective(40.0)";
  return {whole(vectors("dent_", -0.2, 0.2, 1e-3), "[92]"),
          whole(floats("azimuth_", -180, 180, 1), "[1, 1, 2]"),
          whole(floats("elevation_", -60, 60, 1), "[1, 1, 2]"),
          whole(vectors("paint", 0, 1, 1e-3), "[92]"),
          made("face", "ivec3", "mesh.icosphere_face(3)", "[180]"),
          made("clip", "vec4",
               "camera.project(" + lens +
                   " * camera.look_at(camera.orbit(azimuth_, elevation_, 4.0)), "
                   "mesh.icosphere_position(3) * (1.0 + dent_))",
               "[92, 1, 2]")};
}

std::vector<Function> pictures() {
  std::vector<Function> all;
  const std::string across = "  let across = mesh.neighbours(topology($face));\n";
  const std::string picture = "[64, 64, 2]";
  const auto add = [&](const std::string& name, const std::string& part, const std::string& type,
                       const std::string& before, const std::string& value, Directions directions,
                       bool opengl = false) {
    all.push_back({.name = name,
                   .part = part,
                   .result = type + picture,
                   .operands = scene(opengl),
                   .value = value,
                   .directions = std::move(directions),
                   .before = before,
                   .domain = "a dented icosphere in 64 x 64 pixels, two views",
                   .whole = true,
                   .slow = true});
  };
  const Direction to_clip = l2("clip", kFrame, kBeforehand), to_paint = l2("paint", kFrame, kBeforehand);
  // A last place of a coordinate in pixels, seen from a face: how much its weights change.
  const auto kappa = [](const std::string& corner) { return "conditions($clip, " + corner + ")"; };
  const std::string kappa_text = "(L^2 + W L) / 2A of the face, L its longest edge, A its area, W = 64";
  const Direction one = over("value", kFrame, "1.0 + 0.0 * y", "1", kBeforehand);
  for (const bool outlines : {true, false}) {
    const std::string name = outlines ? "hardsoftras.outlines" : "hardsoftras.rasterize";
    const std::string soft =
        (outlines ? across + "  let soft = hardsoftras.outlines($clip, $face, across, 64, 64, radius = 3.px);\n"
                  : "  let soft = hardsoftras.rasterize($clip, $face, 64, 64, radius = 3.px);\n");
    add(name, "distance", "float", soft, "soft.fragment[0].distance",
        {over("value", 0x1p-23, "64.0 + 0.0 * y", "the picture's width", kBeforehand), to_clip});
    add(name, "weight", "vec3", soft, "soft.fragment[0].weight",
        {over("value", 8 * u, kappa("soft.fragment[0].corner"), kappa_text,
              "the bound set beforehand, with the coordinates' own rounding"),
         to_clip});
    add(name, "coverage", "float", soft, "hardsoftras.silhouette(soft)", {one, to_clip});
    add(name, "color", "vec3", soft,
        "hardsoftras.blend(soft, fn(s) { hardsoftras.interpolate(s, paint) }, vec3(0.1, 0.2, 0.3))",
        {over("value", kFrame, "1.0 + 0.0 * y.x", "1", kBeforehand), to_clip, to_paint});
  }
  add("coverage.silhouette", "", "float", across, "coverage.silhouette($clip, $face, across, 64, 64)", {one, to_clip});
  add("coverage.crowded", "", "float", across,
      "if coverage.crowded($clip, $face, across, 2, 2, nearest = 1).at(coord(64, 64).xy / 32) { 1.0 } else { 0.0 }",
      {one});
  add("coverage.crowded_faces", "", "float", across,
      "if coverage.crowded_faces($clip, $face, across, 2, 2).at(coord(64, 64).xy / 32) { 1.0 } else { 0.0 }", {one});
  add("coverage.blend", "", "vec3", across,
      "coverage.blend($clip, $face, across, 64, 64, fn(hit) { raster.interpolate(hit, paint) }, vec3(0.1, 0.2, 0.3))",
      {over("value", kFrame, "1.0 + 0.0 * y.x", "1", kBeforehand), to_clip, to_paint});
  add("coverage.faces", "", "vec3", across + "  let own = paint.at($face.x);\n",
      "coverage.faces($clip, $face, across, own, 64, 64, vec3(0.1, 0.2, 0.3))",
      {over("value", kFrame, "1.0 + 0.0 * y.x", "1", kBeforehand), to_clip, to_paint});
  const std::string hit = "  let hit = raster.rasterize($clip, $face, 64, 64);\n";
  add("raster.rasterize", "weight", "vec3", hit, "hit.weight",
      {over("value", 8 * u, kappa("hit.corner"), kappa_text,
            "the bound set beforehand, with the coordinates' own rounding"),
       to_clip});
  for (const char* way : {"weight_dx", "weight_dy"})
    add("raster.rasterize", way, "vec3", hit, std::string("hit.") + way,
        {over("value", 8 * u, kappa("hit.corner") + " * (1.0 + length(y))", kappa_text + ", times 1 + the result",
              "like the weights"),
         l2("clip", 1e-3, "second derivatives of weights: faces seen from the side have nearly all of the sum")});
  add("raster.rasterize", "depth", "float", hit, "hit.depth",
      {relative("value", 2e-6, kBeforehand), l2("clip", kFrame, kBeforehand)});
  const std::string color =
      hit + across +
      "  let color = if hit.face >= 0 { raster.interpolate(hit, paint) } else { vec3(0.1, 0.2, 0.3) };\n";
  const Direction frame = over("value", kFrame, "1.0 + 0.0 * y.x", "1", kBeforehand);
  add("raster.antialias", "", "vec3", color, "raster.antialias(color, hit, $clip, $face, across)",
      {frame, to_clip, to_paint});
  const std::string nv = "  let (rast, hit) = nvdiffrast.rasterize($clip, $face, 64, 64);\n";
  add("nvdiffrast.rasterize", "", "vec4", nv, "rast",
      {over("value", 8 * u, kappa("hit.corner"), kappa_text, "like raster.rasterize"), to_clip}, true);
  add("nvdiffrast.antialias", "", "vec3",
      nv + across + "  let color = if hit.face >= 0 { raster.interpolate(hit, paint) } else { vec3(0.1, 0.2, 0.3) };\n",
      "nvdiffrast.antialias(color, hit, $clip, $face, across)", {frame, to_clip, to_paint}, true);
  const Operand image = whole(vectors("image", 0, 1, 1e-3), "[16, 8]");
  all.push_back({.name = "coverage.spread",
                 .part = {},
                 .result = "vec3[16, 8]",
                 .operands = {image, whole(floats("far", 0, 6, 1e-3), "[1]")},
                 .value = "coverage.spread(image, far)",
                 .directions = {over("value", 32 * u, "1.0 + 0.0 * y.x", "1", "sums of 14 terms, twice"),
                                l2("image", 1e-6, "the bound set beforehand for dot products")},
                 .whole = true});
  all.push_back(
      {.name = "coverage.l2",
       .part = {},
       .result = "float[1]",
       .operands = {floats("a", 0, 1, 1e-3), floats("b", 0, 1, 1e-3), whole(floats("far", 0, 3, 1e-3), "[1]")},
       .value = "coverage.l2(a, b, far)",
       .directions = {over("value", 32 * u, "1.0 + 0.0 * y", "1", "sums of 14 terms, twice"),
                      l2("a", 1e-6, "the bound set beforehand for dot products"),
                      l2("b", 1e-6, "the bound set beforehand for dot products")},
       .whole = true});
  all.push_back(
      {.name = "nvdiffrast.texture",
       .part = {},
       .result = "vec3",
       .operands = {image, vectors("uv", -0.5, 1.5, 1e-6, "vec2"), vectors("dx", -1, 1, 1e-4, "vec2"),
                    vectors("dy", -1, 1, 1e-4, "vec2")},
       .value = "nvdiffrast.texture(image, uv, dx, dy, 3)",
       .directions = {conditioned("value", 16 * u), l2("image", 1e-6, "the bound set beforehand for dot products"),
                      conditioned("uv", 64 * u, "like texture.trilinear"),
                      conditioned("dx", 64 * u, "like texture.trilinear")}});
  return all;
}

std::vector<Function> of_tiles() {
  const Operand face = {.name = "face", .type = "int", .low = -1, .high = 1};
  const Operand rows = {.name = "rows", .type = "uint", .low = 0, .high = 4294967295.0, .extent = "[2, 64]"};
  const Operand p = {.name = "p", .type = "ivec2", .low = 0, .high = 63};
  const Operand tile = {.name = "tile", .type = "bool", .low = 0, .high = 1, .extent = "[8, 8]"};
  std::vector<Function> all;
  const auto exact = [&](const std::string& name, const std::string& result, const std::string& value,
                         Operands operands) {
    all.push_back({.name = "tiles." + name,
                   .part = {},
                   .result = result,
                   .operands = std::move(operands),
                   .value = value,
                   .directions = {equal()},
                   .domain = "a picture of 64 x 64",
                   .whole = true});
  };
  exact("rows", "uint[2, 64]", "tiles.rows(face)", {face});
  exact("bit", "int", "(if tiles.bit(rows, p) { 1 } else { 0 })", {rows, p});
  exact("border", "uint[2, 64]", "tiles.border(rows, 64, 3)", {rows});
  exact("blocks", "uint[2, 2]", "tiles.blocks(rows)", {rows});
  exact("with_tiles", "uint[2, 64]", "tiles.with_tiles(rows, tile)", {rows, tile});
  exact(
      "fitted", "vec2", "tiles.fitted(rows, tiles.blocks(rows), a, high, 64).low",
      {rows, vectors("a", -70, 70, 1e-3, "vec2"), vectors("b_", 0, 100, 1e-3, "vec2"), made("high", "vec2", "a + b_")});
  return all;
}

}  // namespace

std::vector<Function> picture_functions() {
  std::vector<Function> all = of_fragments();
  for (auto&& part : {pictures(), of_tiles()}) all.insert(all.end(), part.begin(), part.end());
  return all;
}

}  // namespace dr::accuracy::library
