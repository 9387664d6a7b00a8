// SPDX-License-Identifier: Apache-2.0
// std.camera, std.light and std.shading: functions of an element.
#include "tests/device/accuracy/library_table.h"

namespace dr::accuracy::library {

namespace {

std::vector<Function> camera_functions() {
  const Operand near = floats("near", 1e-6, 10), ratio = floats("ratio_", 1.001, 1e9);
  const Operand far = made("far", "float", "near * ratio_");
  // What normalizing gives an adjoint, of which most cancels where the camera looks at the origin, and what the
  // rounding of eye - target makes of it.
  const auto slope = [](const char* of, const std::string& first, const std::string& more) {
    Direction d = over(of, 32 * u,
                       "sizes_together(g) * (" + first +
                           " + (1.0 + length(eye)) * (length(eye) + length(target)) / (away * away * sine * sine) * " +
                           more + ")",
                       "(1 + |eye|) (|eye| + |target|) / |eye - target|^2 / sin^2", "the steps of two normalizations");
    d.except = "sine < 1e-3";
    d.except_text = "sin < 1e-3 between up and the view";
    return d;
  };
  const Operand matrix = vectors("m", -100, 100, 1e-4, "mat4");
  return {
      {.name = "camera.look_at",
       .part = {},
       .result = "mat4",
       .operands = {vectors("eye", -100, 100, 1e-3), vectors("target", -100, 100, 1e-3), vectors("up", -2, 2, 1e-2)},
       .value = "camera.look_at(eye, target, up)",
       .directions = {conditioned("value", 16 * u), slope("eye", "1.0", "1.0"), slope("target", "0.0", "1.0"),
                      slope("up", "0.0", "away / length(up)")},
       .before = "  let away = distance(eye, target);\n"
                 "  let sine = length(cross(normalize(up), normalize(eye - target)));\n"},
      {.name = "camera.orbit",
       .part = {},
       .result = "vec3",
       .operands = {floats("azimuth", -720, 720, 1e-4), floats("elevation", -90, 90, 1e-4), floats("away", 1e-3, 1e3)},
       .value = "camera.orbit(azimuth, elevation, away)",
       .directions = {conditioned("value", 8 * u),
                      by_built_ins(conditioned("azimuth", 8 * u), "radians(away) * length(g)",
                                   "away |adjoint| pi / 180"),
                      by_built_ins(conditioned("elevation", 8 * u), "radians(away) * length(g)",
                                   "away |adjoint| pi / 180"),
                      by_built_ins(conditioned("away", 8 * u), "length(g)", "|adjoint|")}},
      {.name = "camera.perspective",
       .part = {},
       .result = "mat4",
       .operands = {floats("fov", 0.01, 179.9), floats("aspect", 0.1, 10), near, ratio, far},
       .value = "camera.perspective(fov, aspect, near, far)",
       .directions = all_conditioned(16 * u, 16 * u, {"fov", "aspect", "near", "far"}),
       .domain = "far / near 1.001 … 1e9"},
      {.name = "camera.depth_scale",
       .part = {},
       .result = "float",
       .operands = {near, ratio, far},
       .value = "camera.depth_scale(near, far)",
       .directions = all_conditioned(16 * u, 16 * u, {"near", "far"}),
       .domain = "far / near 1.001 … 1e9"},
      {.name = "camera.orthographic",
       .part = {},
       .result = "mat4",
       .operands = {floats("height", 1e-3, 1e6), floats("aspect", 0.1, 10), near, ratio, far},
       .value = "camera.orthographic(height, aspect, near, far)",
       .directions = all_conditioned(8 * u, 16 * u, {"height", "aspect", "near", "far"}),
       .domain = "far / near 1.001 … 1e9"},
      {.name = "camera.intrinsics",
       .part = {},
       .result = "mat4",
       .operands = {vectors("focal", 1, 1e4, 1, "vec2"), vectors("center", -1e4, 1e4, 1, "vec2"),
                    vectors("size", 1, 16384, 1, "vec2"), near, ratio, far},
       .value = "camera.intrinsics(focal, center, size, near, far)",
       .directions = all_conditioned(8 * u, 16 * u, {"focal", "center", "size", "near", "far"}),
       .domain = "far / near 1.001 … 1e9"},
      {.name = "camera.project",
       .part = {},
       .result = "vec4",
       .operands = {matrix, vectors("p", -1e4, 1e4, 1e-6)},
       .value = "camera.project(m, p)",
       .directions = {over("value", 4 * u, "sizes4(m) * abs(vec4(p, 1.0))", "the sum of the terms' sizes", kFew),
                      relative("m", 2 * u, kFew), relative("p", 2 * u, kFew)}},
      {.name = "camera.to_pixels",
       .part = {},
       .result = "vec2",
       .operands = {vectors("clip_", -100, 100, 1e-6, "vec3"), floats("w_", 1e-3, 1e4),
                    made("clip", "vec4", "vec4(clip_, w_)")},
       .value = "camera.to_pixels(clip, 640, 480)",
       .directions = all_conditioned(4 * u, 8 * u, {"clip"}),
       .domain = "w 1e-3 … 1e4"},
      {.name = "camera.rotate",
       .part = {},
       .result = "vec3",
       .operands = {vectors("r", -3.14159, 3.14159, 1e-20), vectors("v", -100, 100, 1e-6)},
       .value = "camera.rotate(r, v)",
       .directions = {over("value", 8 * u, "length(v) * (1.0 + length(r))", "|v| (1 + |r|)",
                           "the angle's own rounding"),
                      over("v", 8 * u, "length(g) * (1.0 + length(r))", "|adjoint| (1 + |r|)", "like the value"),
                      over("r", 64 * u, "length(g) * length(v)", "|v| |adjoint|",
                           "1e-6 and the angle's own rounding")}},
      {.name = "camera.rotation_matrix",
       .part = {},
       .result = "mat3",
       .operands = {vectors("r", -3.14159, 3.14159, 1e-20)},
       .value = "camera.rotation_matrix(r)",
       .directions = {over("value", 16 * u, "1.0 + length(r)", "1 + |r|", "three columns like rotate"),
                      over("r", 64 * u, "2.0 + 0.0 * r.x", "|adjoint|, 2 at most", "like rotate")}},
      {.name = "camera.rigid",
       .part = {},
       .result = "mat4",
       .operands = {vectors("r", -3.14159, 3.14159, 1e-20), vectors("t", -100, 100, 1e-6)},
       .value = "camera.rigid(r, t)",
       .directions = {over("value", 16 * u, "1.0 + length(r)", "1 + |r|", "like rotation_matrix"),
                      over("r", 64 * u, "2.0 + 0.0 * r.x", "|adjoint|, 2 at most", "like rotate"), equal("t")}},
      {.name = "camera.depth_axis",
       .part = {},
       .result = "vec3",
       .operands = {matrix},
       .value = "camera.depth_axis(m)",
       .directions = {over("value", 4 * u, "1.0 + 0.0 * m[0].x", "1", "one normalization"),
                      over("m", 16 * u, "length(g) / length(transpose(m)[2].xyz)", "|adjoint| / |axis|",
                           "one normalization")}},
      {.name = "camera.from_opencv",
       .part = {},
       .result = "mat4",
       .operands = {matrix},
       .value = "camera.from_opencv(m)",
       .directions = {equal(), equal("m")}},
      {.name = "camera.from_opengl_clip",
       .part = {},
       .result = "mat4",
       .operands = {matrix},
       .value = "camera.from_opengl_clip(m)",
       .directions = all_conditioned(2 * u, u, {"m"})},
      {.name = "camera.to_opengl_clip",
       .part = {},
       .result = "mat4",
       .operands = {matrix},
       .value = "camera.to_opengl_clip(m)",
       .directions = all_conditioned(2 * u, u, {"m"})},
      {.name = "camera.along",
       .part = {},
       .result = "mat4",
       .operands = {vectors("d", -100, 100, 1e-6, "vec4")},
       .value = "camera.along(d)",
       .directions = {equal(), equal("d")}},
      {.name = "camera.ball",
       .part = {},
       .result = "vec4[1]",
       .operands = {whole(vectors("p", -100, 100, 1e-3), "[4096]")},
       .value = "camera.ball(p)",
       .directions = {conditioned("value", 4 * u), l2("p", 16 * u, kFew)},
       .whole = true},
  };
}

std::vector<Function> light_functions() {
  const Operand coefficients = whole(vectors("c", -8, 8, 1e-3), "[9]");
  const std::string sum = "sizes_of_nine(c)";
  return {
      {.name = "light.point",
       .part = "direction",
       .result = "vec3",
       .operands = {vectors("lamp", -100, 100, 1e-4), vectors("at", -100, 100, 1e-4)},
       .value = "light.point(lamp, at).direction",
       .directions = all_conditioned(8 * u, 16 * u, {"lamp", "at"}, kBeforehand)},
      {.name = "light.point",
       .part = "color",
       .result = "vec3",
       .operands = {vectors("lamp", -100, 100, 1e-4), vectors("at", -100, 100, 1e-4), vectors("color", 1e-3, 100)},
       .value = "light.point(lamp, at, color).color",
       .directions = all_conditioned(8 * u, 16 * u, {"lamp", "at", "color"})},
      {.name = "light.directional",
       .part = {},
       .result = "vec3",
       .operands = {vectors("d", -1e30, 1e30, 1e-30)},
       .value = "light.directional(d).direction",
       .directions = {relative("value", 8 * u, kBeforehand),
                      over("d", 16 * u, "length(g) / length(d)", "|adjoint| / |d|", kBeforehand)}},
      {.name = "light.harmonics",
       .part = {},
       .result = "float",
       .operands = join({unit("n"), {{.name = "k", .type = "int", .low = 0, .high = 8}}}),
       .value = "light.harmonics(n)[k]",
       .directions = {over("value", 4e-7, "1.0 + 0.0 * n.x", "1", kBeforehand),
                      over("n", 4e-7, "2.0 * abs(g)", "2 |adjoint|", kBeforehand)}},
      {.name = "light.radiance",
       .part = {},
       .result = "vec3",
       .operands = join({{coefficients}, unit("n")}),
       .value = "light.radiance(c, n)",
       .directions = {over("value", 4e-7, sum, "the sum of the coefficients' sizes", kBeforehand),
                      over("n", 4e-7, "2.0 * dot(abs(g), " + sum + ")", "twice that sum times |adjoint|", kBeforehand),
                      l2("c", 2e-7, "the bound set beforehand for sums")}},
      {.name = "light.irradiance",
       .part = {},
       .result = "vec3",
       .operands = join({{coefficients}, unit("n")}),
       .value = "light.irradiance(c, n)",
       .directions = {over("value", 4e-7, sum, "the sum of the coefficients' sizes", kBeforehand),
                      over("n", 4e-7, "2.0 * dot(abs(g), " + sum + ")", "twice that sum times |adjoint|", kBeforehand),
                      l2("c", 2e-7, "the bound set beforehand for sums")}},
  };
}

std::vector<Function> shading_functions() {
  const Operand albedo = vectors("albedo", 1e-3, 1), color = vectors("color", 1e-3, 100);
  const Operand specular = vectors("specular", 1e-3, 1);
  const Operand shininess = floats("shininess", 1, 1000);
  const auto flat = [](Direction d) {
    d.except = "length(cross(n, t)) <= 1e-2 * length(t) || abs(dot(cross(n, t), b)) <= 1e-4 * length(t) * length(b)";
    d.except_text = "tangents along the normal, or bitangents in their plane";
    return d;
  };
  const Operands scene = join({{albedo, color, specular, shininess}, unit("n"), unit("l"), unit("v")});
  return {
      {.name = "shading.unlit",
       .part = {},
       .result = "vec3",
       .operands = {albedo},
       .value = "shading.unlit(albedo)",
       .directions = {equal(), equal("albedo")}},
      {.name = "shading.lambert",
       .part = {},
       .result = "vec3",
       .operands = join({{albedo, color}, unit("n"), unit("l")}),
       .value = "shading.lambert(albedo, n, light.Light(l, color))",
       .directions = all_conditioned(4 * u, 4 * u, {"albedo", "color", "n", "l"})},
      {.name = "shading.phong",
       .part = {},
       .result = "vec3",
       .operands = scene,
       .value = "shading.phong(albedo, n, light.Light(l, color), v, specular, shininess)",
       .directions = all_conditioned(8 * u, 16 * u, {"albedo", "color", "n", "l", "v", "specular", "shininess"})},
      {.name = "shading.blinn_phong",
       .part = {},
       .result = "vec3",
       .operands = scene,
       .value = "shading.blinn_phong(albedo, n, light.Light(l, color), v, specular, shininess)",
       .directions = all_conditioned(8 * u, 16 * u, {"albedo", "color", "n", "l", "v", "specular", "shininess"})},
      {.name = "shading.highlight",
       .part = {},
       .result = "vec3",
       .operands = join({{color, specular, shininess, floats("a", 1e-3, 1)}, unit("n"), unit("l")}),
       .value = "shading.highlight(n, light.Light(l, color), a, specular, shininess)",
       .directions = all_conditioned(8 * u, 16 * u, {"color", "specular", "shininess", "a"})},
      {.name = "shading.mapped_normal",
       .part = {},
       .result = "vec3",
       .operands = join({unit("n"), {vectors("t", -2, 2, 1e-3), vectors("b", -2, 2, 1e-3), vectors("map", 0, 1)}}),
       .value = "shading.mapped_normal(n, t, b, map)",
       .directions = {flat(conditioned("value", 16 * u)), flat(conditioned("n", 32 * u)),
                      flat(conditioned("t", 32 * u)), flat(conditioned("map", 32 * u))}},
  };
}

}  // namespace

std::vector<Function> point_functions() {
  std::vector<Function> all = camera_functions();
  for (auto&& part : {light_functions(), shading_functions()}) all.insert(all.end(), part.begin(), part.end());
  return all;
}

}  // namespace dr::accuracy::library
