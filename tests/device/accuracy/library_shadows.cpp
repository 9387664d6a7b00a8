// SPDX-License-Identifier: Apache-2.0
// std.shadow: views of lamps, and what points read of a map of any numbers. Whether a texel is nearer than a point and
// which view sees it are decisions: points where a rounding could take another one have the weight 0 in `sure`.
#include "tests/device/accuracy/library_table.h"

namespace dr::accuracy::library {

namespace {

// What a point reads of the light, with the map's depths moved by so much.
std::string lit(const std::string& depth) {
  return "shadow.lit(shadow.map_of(covered, " + depth +
         "), shadow.point_views(lamp), at, normal, layer = "
         "shadow.point_view(lamp, at))";
}

// 1, but 0 where a decision hangs on 1e-4 of depths of up to 8, or on 1e-5 of the way to the lamp: which axis is
// longest, and whether the surface faces the lamp.
const std::string kSure =
    "if " + lit("depth + 1e-4") + " == " + lit("depth - 1e-4") +
    " && max(way_.x, max(way_.y, way_.z)) - max(min(way_.x, way_.y), min(max(way_.x, way_.y), way_.z)) > "
    "1e-5 * length(way_) && abs(dot(normal, at - lamp)) > 1e-5 * length(way_) { 1.0 } else { 0.0 }";

}  // namespace

std::vector<Function> shadow_functions() {
  const Operand d = vectors("d", -2, 2, 1e-2), middle = vectors("middle", -10, 10, 1e-2);
  const std::string why = "a direction's three normalizations, and the products of two matrices";
  const auto steep = [](Direction by) {
    by.except = "length(d.xz) < 0.05 * length(d)";
    by.except_text = "directions within 3 degrees of the vertical, around which the view turns";
    return by;
  };
  const Operand lamp = vectors("lamp", -1, 1, 1e-2);
  return {
      {.name = "shadow.directional_view",
       .part = {},
       .result = "mat4",
       .operands = {d, middle, floats("radius", 0.1, 10)},
       .value = "shadow.directional_view(d, middle, radius)",
       .directions = {steep(conditioned("value", 64 * u, why)), steep(conditioned("d", 256 * u, why)),
                      steep(conditioned("middle", 256 * u, why))}},
      {.name = "shadow.spot_view",
       .part = {},
       .result = "mat4",
       .operands = {middle, d},
       .value = "shadow.spot_view(middle, d)",
       .directions = {steep(conditioned("value", 64 * u, why)), steep(conditioned("d", 256 * u, why)),
                      steep(conditioned("middle", 256 * u, why))}},
      {.name = "shadow.point_views",
       .part = {},
       .result = "mat4[1, 1, 6]",
       .operands = {whole(vectors("lamp", -10, 10, 1e-2), "[1]")},
       .value = "shadow.point_views(lamp)",
       .directions = {relative("value", 16 * u, kFew), l2("lamp", 16 * u, kFew)},
       .whole = true},
      {.name = "shadow.point_view",
       .part = {},
       .result = "int",
       .operands = {vectors("lamp", -10, 10, 1e-2), vectors("at", -10, 10, 1e-2)},
       .value = "shadow.point_view(lamp, at)",
       .directions = {equal()}},
      {.name = "shadow.lit",
       .part = {},
       .result = "float",
       .operands = {whole(floats("covered", 0, 1, 1e-3), "[16, 16, 6]"),
                    whole(floats("depth", 0, 8, 1e-3), "[16, 16, 6]"), whole(lamp, "[1]"), vectors("at", -4, 4, 1e-2),
                    vectors("normal_", -1, 1, 1e-2), made("normal", "vec3", "normalize(normal_)"),
                    made("way_", "vec3", "abs(at - lamp)"), made("sure", "float", kSure)},
       .value = "sure * " + lit("depth"),
       .directions = {conditioned("value", 64 * u, "the place on the map, of 16 texels, and sixteen reads"),
                      l2("covered", 2e-6, "the bound set beforehand for dot products")},
       .domain = "sure 0 where moving the depths by 1e-4 takes another decision, else 1"},
  };
}

}  // namespace dr::accuracy::library
