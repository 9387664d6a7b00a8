// SPDX-License-Identifier: Apache-2.0
// std.mesh: functions of a few points, and of an icosphere that is dented and flattened.
#include "tests/device/accuracy/library_table.h"

namespace dr::accuracy::library {

namespace {

constexpr const char* kVertices = "[812]";
constexpr const char* kFaces = "[1620]";

// Edges of any length, faces of any shape; a box of 1 x `flat` x 1.
Operands mesh(const std::string& dents = "1.0", const std::string& place = "0.0") {
  return {
      whole(vectors("dent_", -0.3, 0.3, 1e-6), kVertices), whole(floats("flat_", 1e-3, 1), "[1]"),
      made("p", "vec3",
           "mesh.icosphere_position(9) * (1.0 + " + dents + " * dent_) * vec3(1.0, flat_, 1.0) + vec3(" + place + ")",
           kVertices),
      made("face", "ivec3", "mesh.icosphere_face(9)", kFaces)};
}

std::vector<Function> of_points() {
  const Operand a = vectors("a", -100, 100, 1e-4), b = vectors("b", -100, 100, 1e-4), c = vectors("c", -100, 100, 1e-4),
                p = vectors("p", -100, 100, 1e-4);
  const std::string near_ends = "abs(g) * (y / min(min(distance(a, b), distance(b, c)), distance(c, a)) + size * slim)";
  const std::string near_text = "(y / the shortest edge + k L) |adjoint|";
  const std::string roots = "near a corner edges are told apart by squares, to the root of a last place";
  const std::string why = "differences of points are as exact as the largest";
  return {
      {.name = "mesh.cotangent",
       .part = {},
       .result = "float",
       .operands = {a, b},
       .value = "mesh.cotangent(a, b)",
       .directions = all_conditioned(16 * u, 32 * u, {"a", "b"})},
      {.name = "mesh.segment_distance_squared",
       .part = {},
       .result = "float",
       .operands = {p, a, b},
       .value = "mesh.segment_distance_squared(p, a, b)",
       .directions = {over("value", 16 * u, "size * (sqrt(y) + 1e-6 * size)",
                           "L (sqrt(y) + 16 u L), L = |p| + |a| + |b|", why),
                      over("p", 16 * u, "abs(g) * size", "L |adjoint|", why),
                      over("a", 16 * u, "abs(g) * size * (1.0 + sqrt(y) / distance(a, b))",
                           "L (1 + sqrt(y) / |a - b|) |adjoint|", why),
                      over("b", 16 * u, "abs(g) * size * (1.0 + sqrt(y) / distance(a, b))",
                           "L (1 + sqrt(y) / |a - b|) |adjoint|", why)},
       .before = "  let size = length(p) + length(a) + length(b);\n"},
      {.name = "mesh.triangle_distance_squared",
       .part = {},
       .result = "float",
       .operands = {p, a, b, c},
       .value = "mesh.triangle_distance_squared(p, a, b, c)",
       .directions = {over("value", 32 * u, "size * slim * (sqrt(y) + 1e-6 * size * slim)",
                           "k L (sqrt(y) + 16 u k L), L = |p| + |a| + |b| + |c|, k = 1 + L^2 / area", why),
                      over("p", 0x1p-12, near_ends, near_text, roots), over("a", 0x1p-12, near_ends, near_text, roots),
                      over("b", 0x1p-12, near_ends, near_text, roots), over("c", 0x1p-12, near_ends, near_text, roots)},
       .before = "  let size = length(p) + length(a) + length(b) + length(c);\n"
                 "  let slim = 1.0 + size * size / length(cross(b - a, c - a));\n"},
  };
}

std::vector<Function> of_meshes() {
  std::vector<Function> all;
  const auto add = [&](const std::string& name, const std::string& result, const std::string& arguments,
                       Directions directions) {
    all.push_back({.name = "mesh." + name,
                   .part = {},
                   .result = result,
                   .operands = mesh(),
                   .value = "mesh." + name + "(" + arguments + ")",
                   .directions = std::move(directions),
                   .domain = "a dented, flattened icosphere, 812 vertices",
                   .whole = true});
  };
  const std::string table = "topology($face)";
  const std::string longest = "max(distance(p.at(" + table + ".edge.x), p.at(" + table + ".edge.y)))";
  const std::string per_edge = "4u for each of up to 6 edges, set beforehand";
  add("face_normal", std::string("vec3") + kFaces, "p, face", all_conditioned(8 * u, 16 * u, {"p"}));
  add("normal", std::string("vec3") + kVertices, "p, face", all_conditioned(32 * u, 64 * u, {"p"}));
  add("face_count", std::string("float") + kVertices, "p, face", {equal()});
  // Nearly smooth, and far from the origin.
  const auto add_smooth = [&](const std::string& name, const std::string& result, const std::string& arguments,
                              Directions directions) {
    add(name, result, arguments, std::move(directions));
    all.push_back(all.back());
    all.back().part = "smooth";
    all.back().operands = mesh("0.001", "10.0, -20.0, 5.0");
    all.back().operands[1].low = 0.5;
    all.back().domain = "a smooth icosphere around (10, -20, 5), 812 vertices";
  };
  add_smooth("umbrella", std::string("vec3") + kVertices, "p, face",
             {over("value", 24 * u, longest, "the longest edge", per_edge), l2("p", 24 * u, per_edge)});
  const std::string around = "topology($face, 812)";
  add_smooth("around", std::string("vec3") + kVertices, "p, face, " + around,
             {over("value", 24 * u, longest, "the longest edge", per_edge), l2("p", 24 * u, per_edge)});
  add("smoothed", std::string("vec3") + kVertices, "p, face, " + around + ", 2",
      {over("value", 48 * u, longest, "the longest edge", per_edge), l2("p", 48 * u, per_edge)});
  add("outset", std::string("vec3") + kVertices, "p, face, " + around,
      {over("value", 24 * u, longest, "the longest edge", per_edge), l2("p", 24 * u, per_edge)});
  add_smooth("unevenness", "float[1]", "p, face, " + around, {relative("value", 1e-6, kFew), l2("p", 1e-6, kFew)});
  add_smooth("uniform_laplacian", std::string("vec3") + kVertices, "p, " + table,
             {over("value", 24 * u, longest, "the longest edge", per_edge), l2("p", 24 * u, per_edge)});
  add("cotangent_laplacian", std::string("vec3") + kVertices, "p, face",
      {conditioned("value", 128 * u),
       conditioned("p", 256 * u, "second derivatives of thin faces, whose condition is estimated")});
  add_smooth("laplacian", "float[1]", "p, face", {relative("value", 1e-6, kFew), l2("p", 1e-6, kFew)});
  add_smooth("edge_variation", "float[1]", "p, face", {relative("value", 1e-6, kFew), l2("p", 1e-5, kFew)});
  add_smooth("edge_length", "float[1]", "p, " + table, {relative("value", 1e-6, kFew), l2("p", 1e-6, kFew)});
  add("volume", "float[1]", "p, face", {relative("value", 1e-6, kFew), conditioned("p", 64 * u)});
  add_smooth("normal_consistency", "float[1]", "p, face, " + table,
             {relative("value", 1e-6, kFew), l2("p", 1e-5, kFew)});

  Operands charts = mesh();
  charts.push_back(whole(vectors("shift_", -0.004, 0.004, 1e-6, "vec2"), "[1000]"));
  charts.push_back(made("uv", "vec2", "mesh.icosphere_uv(9, 0.01) + shift_", "[1000]"));
  charts.push_back(made("uv_face", "ivec3", "mesh.icosphere_uv_face(9)", kFaces));
  for (const char* k : {"0", "1"})
    all.push_back({.name = "mesh.tangents",
                   .part = k[0] == '0' ? "u" : "v",
                   .result = std::string("vec3") + kFaces,
                   .operands = charts,
                   .value = std::string("mesh.tangents(p, face, uv, uv_face).") + k,
                   .directions = all_conditioned(16 * u, 64 * u, {"p", "uv"}),
                   .domain = "a dented, flattened icosphere and its texture coordinates, shifted",
                   .whole = true});
  all.push_back(
      {.name = "mesh.distance_to",
       .part = {},
       .result = "float",
       .operands = {vectors("q", -2, 2, 1e-3), whole(vectors("dent_", -0.3, 0.3, 1e-6), "[12]"),
                    made("p", "vec3", "mesh.icosphere_position(1) * (1.0 + dent_)", "[12]"),
                    made("face", "ivec3", "mesh.icosphere_face(1)", "[20]")},
       .value = "mesh.distance_to(q, p, face)",
       .directions = {conditioned("value", 16 * u), conditioned("q", 0x1p-12, "like triangle_distance_squared")},
       .domain = "a dented icosphere, 20 faces"});
  const auto generated = [&](const std::string& name, const std::string& result, const std::string& value,
                             double bound) {
    all.push_back({.name = "mesh." + name,
                   .part = {},
                   .result = result,
                   .operands = {},
                   .value = value,
                   .directions = {bound == 0 ? equal() : relative("value", bound, kFew)},
                   .domain = "one mesh",
                   .whole = true});
  };
  generated("globe_position", "vec3[994]", "mesh.globe_position(31, 32)", 8 * u);
  generated("globe_uv", "vec2[994]", "mesh.globe_uv(31, 32)", 2 * u);
  generated("globe_face", "ivec3[1984]", "mesh.globe_face(31, 32)", 0);
  generated("icosphere_position", "vec3[2562]", "mesh.icosphere_position(16)", 8 * u);
  generated("icosphere_uv", "vec2[2890]", "mesh.icosphere_uv(16, 0.01)", 4 * u);
  generated("icosphere_face", "ivec3[5120]", "mesh.icosphere_face(16)", 0);
  generated("icosphere_uv_face", "ivec3[5120]", "mesh.icosphere_uv_face(16)", 0);
  return all;
}

}  // namespace

std::vector<Function> mesh_functions() {
  std::vector<Function> all = of_points();
  for (Function& f : of_meshes()) all.push_back(std::move(f));
  return all;
}

}  // namespace dr::accuracy::library
