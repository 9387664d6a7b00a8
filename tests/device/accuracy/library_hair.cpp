// SPDX-License-Identifier: Apache-2.0
// std.hair.
#include "tests/device/accuracy/library_table.h"

namespace dr::accuracy::library {

namespace {

// The design's for a whole fibre: a product of the terms whose rows are above it.
constexpr double kFiber = 1e-4;

const char* const kHeldExponent = "an exponent of up to 87, and what it is off by";
const char* const kDifference = "a root and quotients of 20 roundings";

// (sin, cos) of an inclination, to 0.2 degrees from the fibre.
Operands inclined(const std::string& name) {
  return {floats(name + "_", -1.567, 1.567, 1e-3), made(name, "vec2", "vec2(sin(" + name + "_), cos(" + name + "_))")};
}

// Where exp underflows, so does a slope that is much larger.
Directions all_but_faint(std::initializer_list<const char*> operands) {
  Directions all = all_conditioned(64 * u, 128 * u, operands, kHeldExponent);
  for (Direction& d : all) {
    d.except = "y < 1e-30";
    d.except_text = "the value is below 1e-30";
  }
  return all;
}

Function of_rough(const std::string& name) {
  return {.name = "hair." + name,
          .part = {},
          .result = "float",
          .operands = {floats("rough", -0.5, 1.5, 1e-6)},
          .value = "hair." + name + "(rough)",
          .directions = all_conditioned(32 * u, 64 * u, {"rough"})};
}

std::vector<Function> hair_parameters() {
  return {
      {.name = "hair.absorption_of_melanin",
       .part = {},
       .result = "vec3",
       .operands = {floats("melanin", 0, 1, 1e-6), floats("redness", 0, 1, 1e-3)},
       .value = "hair.absorption_of_melanin(melanin, redness)",
       .directions = all_conditioned(16 * u, 32 * u, {"melanin", "redness"})},
      {.name = "hair.absorption_of_color",
       .part = {},
       .result = "vec3",
       .operands = {vectors("color", 1e-30, 1, 1e-30), floats("rough", 0, 1, 1e-3)},
       .value = "hair.absorption_of_color(color, rough)",
       .directions = all_conditioned(32 * u, 64 * u, {"color", "rough"})},
      of_rough("variance_of"),
      of_rough("scale_of"),
  };
}

std::vector<Function> hair_terms() {
  const Operands ray = {floats("h", -0.999, 0.999, 1e-3), floats("c", 1e-2, 1, 1e-2), floats("ior", 1, 2, 1)};
  const auto part = [&](const std::string& name, Directions directions, const std::string& before = {}) {
    return Function{.name = "hair.crossing",
                    .part = name,
                    .result = "float",
                    .operands = ray,
                    .value = "hair.crossing(h, c, ior)." + name,
                    .directions = std::move(directions),
                    .before = before};
  };
  const std::initializer_list<const char*> of_ray = {"h", "c", "ior"};
  std::vector<Function> all = {
      {.name = "hair.bessel_i0e",
       .part = {},
       .result = "float",
       .operands = {floats("x", 0, 1e6, 1e-6)},
       .value = "hair.bessel_i0e(x)",
       .directions = {relative("value", 5e-7, kBeforehand),
                      conditioned("x", 64 * u, "a sum of 8 terms and its slope")}},
      {.name = "hair.longitudinal",
       .part = {},
       .result = "float",
       .operands = join({inclined("light"), inclined("camera"), {floats("v", 5e-5, 30, 5e-5)}}),
       .value = "hair.longitudinal(light, camera, v)",
       .directions = all_but_faint({"light", "camera", "v"})},
      {.name = "hair.logistic",
       .part = {},
       .result = "float",
       .operands = {floats("phi", -10, 10, 1e-3), floats("s", 1e-3, 4.3, 1e-3)},
       .value = "hair.logistic(phi, s)",
       .directions = all_but_faint({"phi", "s"})},
      {.name = "hair.inclination",
       .part = {},
       .result = "vec2",
       .operands = join({unit("t"), unit("l")}),
       .value = "hair.inclination(t, l)",
       .directions = all_conditioned(16 * u, 32 * u, {"t", "l"})},
  };
  all.push_back(part("outside", all_conditioned(64 * u, 256 * u, {"h"}, kDifference)));
  all.push_back(part("turn", all_conditioned(64 * u, 256 * u, of_ray, kDifference)));
  all.push_back(part("path", all_conditioned(64 * u, 256 * u, of_ray, kDifference)));
  all.push_back(part("mirrored", {conditioned("value", 64 * u, "material.fresnel, whose row has its slopes")}));
  // Slopes to the cosines outside and inside cancel where the index is near 1: all passes then.
  const std::string why = "two slopes that cancel, of the size of the value over the cosine";
  all.push_back(part(
      "passed",
      {conditioned("value", 64 * u, kDifference),
       over("h", 64 * u, "abs(g) * y / ((1.0 - h) * (1.0 + h))", "value / (1 - h^2) |adjoint|", why),
       over("c", 64 * u, "abs(g) * y / c", "value / c |adjoint|", why), conditioned("ior", 256 * u, kDifference)}));
  return all;
}

std::vector<Function> fibers() {
  const Operands fiber = {vectors("absorption", 1e-3, 4, 1e-3), floats("radial", 0.08, 1, 0.08),
                          floats("around", 0.08, 1, 0.08), floats("ior", 1.05, 2, 1.05), floats("tilt", -4, 4, 1e-2)};
  const Operands ways = join({unit("t"), unit("l"), unit("v")});
  const std::string before = "  let f = hair.Fiber(absorption, radial, around, ior, tilt);\n";
  const Directions directions =
      all_conditioned(kFiber, 1e-3, {"absorption", "radial", "around", "ior", "tilt", "t", "l", "v"}, kBeforehand);
  return {
      {.name = "hair.attenuation",
       .part = {},
       .result = "vec3",
       .operands = {floats("h", -0.999, 0.999, 1e-3), floats("c", 1e-2, 1, 1e-2), floats("ior", 1, 2, 1),
                    vectors("absorption", 0, 8, 1e-3)},
       .value = "a[1] + a[2] + a[3]",
       .directions = all_conditioned(1e-5, 1e-4, {"h", "c", "ior", "absorption"}, kBeforehand),
       .before = "  let a = hair.attenuation(hair.crossing(h, c, ior), absorption);\n"},
      {.name = "hair.scatter",
       .part = {},
       .result = "vec3",
       .operands = join({fiber, ways, {floats("h", -0.999, 0.999, 1e-3)}}),
       .value = "hair.scatter(f, t, l, v, h)",
       .directions = directions,
       .before = before},
      {.name = "hair.scatter_far",
       .part = {},
       .result = "vec3",
       .operands = join({fiber, ways}),
       .value = "hair.scatter_far(f, t, l, v, 3)",
       .directions = directions,
       .before = before},
  };
}

}  // namespace

std::vector<Function> hair_functions() {
  std::vector<Function> all;
  for (auto&& part : {hair_parameters(), hair_terms(), fibers()}) all.insert(all.end(), part.begin(), part.end());
  return all;
}

}  // namespace dr::accuracy::library
