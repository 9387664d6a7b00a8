// SPDX-License-Identifier: Apache-2.0
// std.skin and std.eye.
#include "tests/device/accuracy/library_table.h"

namespace dr::accuracy::library {

namespace {

// Reaches of skin, in millimetres.
Operand reach() { return vectors("reach", 0.1, 4, 0.1); }

std::vector<Function> profiles() {
  // In profile `native` sinh(asinh(x) / 3) is off by 25 last places of 1 as promised, and is 2 (1 - u) / 3.
  Direction within = by_built_ins(over("value", 64 * u, "1.0 + y", "1 + r", "a logarithm near 1 at small radii"),
                                  "1.0 / (1.0 - part)", "1 / (1 - u)");
  within.native = 320 * u;
  within.native_why = "sinh and asinh are promised within 20 and 13 last places of 1";
  Direction within_slope = by_built_ins(over("part", 256 * u, "abs(g) * (1.0 + 1.0 / (1.0 - part))",
                                             "(1 + 1 / (1 - u)) |adjoint|", "a quotient of hyperbolic functions"),
                                        "abs(g) / ((1.0 - part) * (1.0 - part))", "|adjoint| / (1 - u)^2");
  return {
      {.name = "skin.reach_of",
       .part = {},
       .result = "vec3",
       .operands = {vectors("albedo", 0, 1, 1e-3), vectors("path", 0.1, 4, 0.1)},
       .value = "skin.reach_of(albedo, path)",
       .directions = all_conditioned(16 * u, 32 * u, {"albedo", "path"})},
      {.name = "skin.profile",
       .part = {},
       .result = "vec3",
       .operands = {floats("r", 1e-3, 8, 1e-3), reach()},
       .value = "skin.profile(r, reach)",
       .directions = all_conditioned(16 * u, 32 * u, {"r", "reach"})},
      {.name = "skin.beyond",
       .part = {},
       .result = "vec3",
       .operands = {floats("r", 1e-3, 8, 1e-3), reach()},
       .value = "skin.beyond(r, reach)",
       .directions = all_conditioned(16 * u, 32 * u, {"r", "reach"})},
      {.name = "skin.radius_within",
       .part = {},
       .result = "float",
       .operands = {floats("part", 1e-3, 0.999, 1e-3)},
       .value = "skin.radius_within(part)",
       .directions = {within, within_slope}},
      {.name = "skin.tissue",
       .part = "albedo",
       .result = "vec3",
       .operands = {floats("melanin", 0.01, 0.4, 1e-3), floats("blood", 0.002, 0.1, 1e-3)},
       .value = "skin.tissue(melanin, blood).albedo",
       .directions = all_conditioned(32 * u, 64 * u, {"melanin", "blood"})},
      {.name = "skin.tissue",
       .part = "path",
       .result = "vec3",
       .operands = {floats("melanin", 0.01, 0.4, 1e-3), floats("blood", 0.002, 0.1, 1e-3)},
       .value = "skin.tissue(melanin, blood).path",
       .directions = all_conditioned(16 * u, 32 * u, {"blood"})},
      {.name = "skin.through_lips",
       .part = {},
       .result = "float",
       .operands = {vectors("at", 0.05, 0.9, 1e-3), vectors("half", 1, 2, 1, "vec2")},
       .value = "skin.through_lips(at, half)",
       .directions = {over("value", 32 * u, "1.0 + 0.0 * y", "1", "four parts of at most a quarter"),
                      over("at", 64 * u, "abs(g) / at.z", "|adjoint| / depth", "slopes of those"),
                      over("half", 64 * u, "abs(g) / at.z", "|adjoint| / depth", "slopes of those")}},
      {.name = "skin.highlights",
       .part = {},
       .result = "vec3",
       .operands = join(
           {unit("n"), unit("l"), unit("v"), {vectors("rough", 0.2, 1, 0.2, "vec2"), floats("second", 0, 1, 1e-3)}}),
       .value = "skin.highlights(n, light.Light(l, vec3(3.0, 2.0, 1.0)), v, rough, second)",
       .directions = all_conditioned(1e-4, 1e-4, {"n", "l", "v", "rough", "second"}, kBeforehand)},
      {.name = "skin.diffused",
       .part = {},
       .result = "vec3[24, 24]",
       .operands = {whole(vectors("shone", 0, 1, 1e-3), "[24, 24]"), whole(vectors("wide", 0.5, 3, 0.5), "[24, 24]"),
                    made("at", "vec3", "vec3(vec2(coord(24, 24).xy), 0.1 * float(coord(24, 24).x))", "[24, 24]")},
       .value = "skin.diffused(shone, at, 1.0 + 0.0 * at.x, wide, 1.0 + 0.0 * at.x, 16)",
       .directions = {l2("value", 1e-5, "places between texels are off by 24 roundings"),
                      l2("shone", 1e-5, "like the value"),
                      l2("wide", 1e-3, "slopes between texels change from one to the next")},
       .whole = true},
  };
}

std::vector<Function> eyes() {
  const Operands cornea =
      join({unit("n"),
            {vectors("aside_", -1, 1, 1e-3), floats("tilt_", 0, 1.2, 1e-3),
             made("v", "vec3", "normalize(cos(tilt_) * n + sin(tilt_) * normalize(cross(n, aside_)))")}});
  return {
      {.name = "eye.bent",
       .part = {},
       .result = "vec3",
       .operands = join({cornea, {floats("ior", 1.05, 2, 1.05)}}),
       .value = "eye.bent(n, v, ior)",
       .directions = all_conditioned(32 * u, 64 * u, {"n", "v", "ior"})},
      {.name = "eye.iris_place",
       .part = {},
       .result = "vec3",
       .operands = join({cornea, {floats("depth", 0.5, 0.9, 0.5)}}),
       .value = "eye.iris_place(n, n, v, n, depth)",
       .directions = all_conditioned(64 * u, 256 * u, {"n", "v", "depth"})},
      {.name = "eye.iris_uv",
       .part = {},
       .result = "vec2",
       .operands = join({{vectors("at", -1, 1, 1e-3)}, unit("axis"), {vectors("up", -1, 1, 1e-3)}}),
       .value = "eye.iris_uv(at, axis, up)",
       .directions = all_conditioned(32 * u, 64 * u, {"at", "axis", "up"})},
      {.name = "eye.limbus",
       .part = {},
       .result = "float",
       .operands = {vectors("uv", -1, 1, 1e-3, "vec2"), floats("wide", 0.05, 1, 0.05)},
       .value = "eye.limbus(uv, wide)",
       .directions = {over("value", 32 * u, "1.0 / wide + 0.0 * y", "1 / width", "a difference over the width"),
                      over("uv", 128 * u, "abs(g) / (wide * wide)", "|adjoint| / width^2", "slopes of a step"),
                      over("wide", 128 * u, "abs(g) / (wide * wide)", "|adjoint| / width^2", "slopes of a step")}},
  };
}

}  // namespace

std::vector<Function> skin_functions() {
  std::vector<Function> all = profiles();
  const std::vector<Function> more = eyes();
  all.insert(all.end(), more.begin(), more.end());
  return all;
}

}  // namespace dr::accuracy::library
