// SPDX-License-Identifier: Apache-2.0
// std.environment. Reads are as far off as those of std.texture: contrast, by the rounding of where they read.
// Directions reach a place by two arctangents, of 16 u of a turn, on a map of 16 texels around.
#include "tests/device/accuracy/library_table.h"

namespace dr::accuracy::library {

namespace {

std::vector<Function> reads() {
  const Operand map = whole(vectors("map", 0, 1, 1e-3), "[16, 8]");
  const Operand box = whole(vectors("map", 0, 1, 1e-3), "[6, 6, 6]");
  const Operand uv = vectors("uv", -0.5, 1.5, 1e-6, "vec2");
  const std::string contrast = "max(map) - min(map)";
  const std::string why = "the 4u set beforehand, and the place's own rounding";
  const Direction to_map = l2("map", 2e-6, "the bound set beforehand for dot products");
  const auto by_place = [&](double bound) {
    return over("value", bound, "(" + contrast + ") * 16.0", "contrast times the map's width", why);
  };
  return {
      {.name = "environment.around",
       .part = {},
       .result = "vec3",
       .operands = {map, uv},
       .value = "environment.around(map, uv)",
       .directions = {by_place(4 * u), to_map}},
      {.name = "environment.radiance",
       .part = {},
       .result = "vec3",
       .operands = {map, vectors("d", -100, 100, 1e-3)},
       .value = "environment.radiance(map, d)",
       .directions = {by_place(8 * u), to_map}},
      {.name = "environment.mirrored",
       .part = {},
       .result = "vec3",
       .operands = {map, vectors("d", -100, 100, 1e-3), floats("roughness", 0, 1, 1e-3)},
       .value = "environment.mirrored(environment.stacked(environment.pyramid(map, 3)), d, roughness)",
       .directions = {by_place(8 * u), to_map,
                      over("roughness", 64 * u, "2.0 * dot(abs(g), " + contrast + ") * 16.0",
                           "contrast times the map's width times |adjoint|, twice", why)}},
      {.name = "environment.cube",
       .part = {},
       .result = "vec3",
       .operands = {box, vectors("d", -100, 100, 1e-3)},
       .value = "environment.cube(map, d)",
       .directions = {over("value", 8 * u, "(" + contrast + ") * 6.0", "contrast times a face's width", why), to_map}},
      {.name = "environment.cube_texel",
       .part = {},
       .result = "vec3",
       .operands = {box,
                    {.name = "face", .type = "int", .low = 0, .high = 5},
                    {.name = "p", .type = "ivec2", .low = -1, .high = 6}},
       .value = "environment.cube_texel(map, face, p)",
       .directions = {over("value", 4 * u, contrast, "contrast", "the mean of three at a corner"), to_map}},
      {.name = "environment.to_cube",
       .part = {},
       .result = "vec3[6, 6, 6]",
       .operands = {map},
       .value = "environment.to_cube(map, 6)",
       .directions = {by_place(8 * u), to_map},
       .whole = true},
  };
}

std::vector<Function> places() {
  const Operand face = {.name = "face", .type = "int", .low = 0, .high = 5};
  const Operand row = {.name = "row", .type = "int", .low = 0, .high = 31};
  return {
      {.name = "environment.solid_angle",
       .part = {},
       .result = "float",
       .operands = {row},
       .value = "environment.solid_angle(row, 64, 32)",
       .directions = {relative("value", 64 * u, "a sine of an angle up to pi")}},
      {.name = "environment.cube_direction",
       .part = {},
       .result = "vec3",
       .operands = {face, vectors("uv", 0, 1, 1e-6, "vec2")},
       .value = "environment.cube_direction(face, uv)",
       .directions = {over("value", 4 * u, "1.0 + 0.0 * uv.x", "1", kFew)},
       .transposed = {"uv"}},
      {.name = "environment.cube_face",
       .part = {},
       .result = "int",
       .operands = {vectors("d", -100, 100, 1e-3)},
       .value = "environment.cube_face(d)",
       .directions = {equal()}},
      {.name = "environment.cube_uv",
       .part = {},
       .result = "vec2",
       .operands = {vectors("d", -100, 100, 1e-3)},
       .value = "environment.cube_uv(environment.cube_face(d), d)",
       .directions = all_conditioned(4 * u, 8 * u, {"d"})},
      {.name = "environment.lobe_points",
       .part = {},
       .result = "vec4[64]",
       .operands = {whole(floats("alpha", 2e-3, 1, 2e-3), "[1]")},
       .value = "environment.lobe_points(64, alpha, 8192)",
       .directions = {over("value", 64 * u, "8.0 + 0.0 * abs(y)", "the largest level, 8", "a logarithm of a square")},
       .whole = true,
       .transposed = {"alpha"}},
  };
}

std::vector<Function> filters() {
  const Operand map = whole(vectors("map", 0, 1, 1e-3), "[16, 8]");
  const Operand large = whole(vectors("map", 0, 1, 1e-3), "[64, 32]");
  const Operand alpha = whole(floats("alpha", 0.1, 1, 1e-3), "[1]");
  const std::string why = "the bound set beforehand for sums, and the rounding of the weights";
  const std::string points = "environment.lobe_points(64, 0.25, 2048)";
  // At the poles all columns of a map meet: what turns around a pole by a rounding reads another texel.
  const std::string upright =
      "reduce(min, i in 0..64) { length((points_.at(i).x * environment.across(d) + "
      "points_.at(i).y * cross(d, environment.across(d)) + points_.at(i).z * d).xz) }";
  return {
      {.name = "environment.halve",
       .part = {},
       .result = "vec3[32, 16]",
       .operands = {large},
       .value = "environment.halve(map)",
       .directions = {relative("value", 128 * u, "two solid angles"), relative("map", 128 * u, "two solid angles")},
       .whole = true},
      {.name = "environment.pyramid",
       .part = {},
       .result = "vec3[16, 8]",
       .operands = {large},
       .value = "environment.pyramid(map, 3)[2]",
       .directions = {relative("value", 256 * u, "two halvings"), relative("map", 256 * u, "two halvings")},
       .whole = true},
      {.name = "environment.stacked",
       .part = {},
       .result = "vec3[64, 56]",
       .operands = {large},
       .value = "environment.stacked(environment.pyramid(map, 3)).texels",
       .directions = {relative("value", 256 * u, "two halvings"), relative("map", 256 * u, "two halvings")},
       .whole = true},
      {.name = "environment.harmonics",
       .part = {},
       .result = "vec3[9]",
       .operands = {large},
       .value = "environment.harmonics(map)",
       .directions = {over("value", 16 * u, "7.0 + 0.0 * abs(y)", "the sum of the terms' sizes", why),
                      l2("map", 1e-6, why)},
       .whole = true},
      {.name = "environment.irradiance_map",
       .part = {},
       .result = "vec3[8, 4]",
       .operands = {map},
       .value = "environment.irradiance_map(map, 8, 4)",
       .directions = {relative("value", 2e-6, why), l2("map", 2e-6, why)},
       .whole = true},
      {.name = "environment.prefilter_map",
       .part = {},
       .result = "vec3[8, 4]",
       .operands = {map, alpha},
       .value = "environment.prefilter_map(map, alpha, 8, 4)",
       .directions = {relative("value", 1e-5, why), l2("map", 1e-5, why)},
       .whole = true},
      {.name = "environment.prefiltered",
       .part = {},
       .result = "vec3",
       .operands = join({{map},
                         unit("d"),
                         {made("points_", "vec4", points, "[64]"),
                          made("sure", "float", "if " + upright + " > 0.02 { 1.0 } else { 0.0 }")}}),
       .value = "sure * environment.prefiltered(environment.stacked(environment.pyramid(map, 3)), d, " + points + ")",
       .directions = {over("value", 16 * u, "(max(map) - min(map)) * 16.0", "contrast times the map's width", why),
                      l2("map", 1e-5, why)},
       .domain = "sure 0 where a point of the lobe comes within 0.02 of a pole, else 1"},
      {.name = "environment.prefilter",
       .part = {},
       .result = "vec3[16, 8]",
       .operands = {large},
       .value = "environment.prefilter(map, 3, 16, 2, 3).texels.at(coord(16, 8).xy + ivec2(0, 48))",
       .directions = {over("value", 32 * u, "(max(map) - min(map)) * 64.0", "contrast times the map's width", why),
                      l2("map", 1e-5, why)},
       .whole = true},
  };
}

}  // namespace

std::vector<Function> environment_functions() {
  std::vector<Function> all = reads();
  for (auto&& part : {places(), filters()}) all.insert(all.end(), part.begin(), part.end());
  return all;
}

}  // namespace dr::accuracy::library
