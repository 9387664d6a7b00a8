// SPDX-License-Identifier: Apache-2.0
// std.strands: 12 strands of 8 vertices that wave across 64 x 64 pixels, from 0.05 to 3 pixels wide.
#include "tests/device/accuracy/library_table.h"

namespace dr::accuracy::library {

namespace {

constexpr double kPicture = 1e-4;
constexpr const char* kPoints = "[96]";

Operands waving() {
  return {whole(vectors("bend_", -0.05, 0.05, 1e-4, "vec2"), kPoints),
          made("clip", "vec4",
               "vec4(0.27 * float(coord(96).x % 8) - 0.95 + bend_.x, 0.16 * float(coord(96).x / 8) - 0.9 + bend_.y, "
               "0.5 + 0.03 * float(coord(96).x / 8), 1.0)",
               kPoints),
          whole(floats("wide", 0.05, 3, 0.05), kPoints), whole(vectors("paint", 0, 1, 1e-3), kPoints)};
}

// A lock that a lamp above sees from its tips.
Operands lock() {
  return {made("view", "mat4", "shadow.directional_view(vec3(0.2, 1.0, 0.1), vec3(0.0), 2.0)", "[1]"),
          whole(vectors("bend_", -0.1, 0.1, 1e-4), kPoints),
          made("p", "vec3",
               "vec3(0.2 * float(coord(96).x % 8) - 0.7, 0.1 * float(coord(96).x % 5), 0.1 * float(coord(96).x / 8) - "
               "0.6) + bend_",
               kPoints),
          whole(floats("wide", 0.05, 0.3, 0.05), kPoints)};
}

const std::string kDeep = "  let deep = strands.deep_opacity($view, p, strands.segments(12, 8), wide, 16, 1.0);\n";

const std::string kHits =
    "  let hits = strands.rasterize($clip, strands.segments(12, 8), strands.strand_of(12, 8), "
    "wide, 64, 64, 4);\n";

}  // namespace

std::vector<Function> strand_functions() {
  const Direction one = over("value", kPicture, "1.0 + 0.0 * y", "1", kBeforehand);
  const Directions drawn = {one, l2("clip", kPicture, kBeforehand), l2("wide", kPicture, kBeforehand)};
  Directions colored = {over("value", kPicture, "1.0 + 0.0 * y.x", "1", kBeforehand), l2("clip", kPicture, kBeforehand),
                        l2("wide", kPicture, kBeforehand), l2("paint", kPicture, kBeforehand)};
  // Two sides that run along each other, 1e-3 to 2 pixels apart.
  const Operands ribbon = {vectors("a", -1, 1, 1e-3, "vec2"),
                           vectors("way_", -2, 2, 1e-3, "vec2"),
                           floats("wide_", 1e-3, 2, 1e-3),
                           made("b", "vec2", "a + way_"),
                           made("c", "vec2", "b + wide_ * normalize(vec2(-way_.y, way_.x))"),
                           made("d", "vec2", "a + wide_ * normalize(vec2(-way_.y, way_.x))")};
  const auto to = [&](const char* name) {
    return over(name, 64 * u, "abs(g) * (1.0 + distance(a, b) + distance(b, c))", "(1 + length + width) |adjoint|",
                "ends of the parts of sides, each a quotient of differences");
  };
  return {
      {.name = "strands.square_area",
       .part = {},
       .result = "float",
       .operands = ribbon,
       .value = "strands.square_area(a, b, c, d)",
       .directions = {over("value", 16 * u, "1.0 + 0.0 * y", "1", "the difference of two areas below lines"), to("a"),
                      to("b"), to("c"), to("d")}},
      {.name = "strands.tangents",
       .part = {},
       .result = "vec3[96]",
       .operands = {whole(vectors("p", -2, 2, 1e-3), kPoints)},
       .value = "strands.tangents(p, strands.segments(12, 8))",
       .directions = {l2("value", 1e-6, kFew),
                      l2("p", 1e-4, "where two segments nearly run back, their mean turns fast")},
       .whole = true},
      {.name = "strands.pixel_widths",
       .part = {},
       .result = "float[96]",
       .operands = {made("view", "mat4", "camera.perspective(40.0) * camera.look_at(vec3(0.3, 0.4, 3.0))", "[1]"),
                    whole(vectors("clip", 0.5, 4, 0.5, "vec4"), kPoints), whole(floats("wide", 0, 1, 1e-4), kPoints)},
       .value = "strands.pixel_widths(view, clip, wide, 64)",
       .directions = {relative("value", 16 * u, kFew), l2("clip", 32 * u, kFew), l2("wide", 32 * u, kFew)},
       .whole = true},
      {.name = "strands.deep_opacity",
       .part = "taken",
       .result = "float[16, 16, 4]",
       .operands = lock(),
       .value = "deep.taken",
       .directions = {l2("value", 1e-5, "places between texels and slices are off by 32 roundings"),
                      l2("p", 1e-5, "slopes by those places"), l2("wide", 1e-5, kFew)},
       .before = kDeep,
       .whole = true},
      {.name = "strands.lit",
       .part = {},
       .result = "float[96]",
       .operands = lock(),
       .value = "strands.lit(deep, view, p + vec3(0.01, -0.2, 0.02))",
       .directions = {l2("value", 4e-6, "like the map"), l2("p", 1e-5, "slopes by places in it"),
                      l2("wide", 1e-5, kFew)},
       .before = kDeep,
       .whole = true},
      {.name = "strands.rasterize",
       .part = "area",
       .result = "float[64, 64]",
       .operands = waving(),
       .value = "hits[0].area",
       .directions = drawn,
       .before = kHits,
       .whole = true},
      {.name = "strands.silhouette",
       .part = {},
       .result = "float[64, 64]",
       .operands = waving(),
       .value = "strands.silhouette(hits)",
       .directions = drawn,
       .before = kHits,
       .whole = true},
      {.name = "strands.blend",
       .part = {},
       .result = "vec3[64, 64]",
       .operands = waving(),
       .value = "strands.blend(hits, fn(h) { strands.interpolate(h, paint) }, vec3(0.1, 0.2, 0.3), 0.8)",
       .directions = std::move(colored),
       .before = kHits,
       .whole = true},
  };
}

}  // namespace dr::accuracy::library
