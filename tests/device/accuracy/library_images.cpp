// SPDX-License-Identifier: Apache-2.0
// Functions of whole images of std.loss and std.texture.
#include "tests/device/accuracy/library_table.h"

namespace dr::accuracy::library {

namespace {

constexpr double kSum = 2e-7;  // the bound set beforehand for sums over images

std::vector<Function> losses() {
  const Operand a = vectors("a", -8, 8, 1e-3), b = vectors("b", -8, 8, 1e-3), mask = floats("mask", 0, 1, 1e-3);
  const std::string why = "the bound set beforehand for sums, and a few roundings of each term";
  std::vector<Function> all;
  const auto measure = [&](const std::string& name, const std::string& arguments, Operands operands,
                           Directions extra = {}) {
    Directions directions = {relative("value", kSum + 4 * u, why)};
    for (Direction& d : extra) directions.push_back(std::move(d));
    all.push_back({.name = "loss." + name,
                   .part = {},
                   .result = "float[1]",
                   .operands = std::move(operands),
                   .value = "loss." + name + "(" + arguments + ")",
                   .directions = std::move(directions),
                   .whole = true});
  };
  const Direction to_a = conditioned("a", 8 * u), to_b = conditioned("b", 8 * u);
  measure("l1", "a, b", {a, b}, {to_a, to_b});
  measure("l2", "a, b", {a, b}, {to_a, to_b});
  measure("huber", "a, b, 0.5", {a, b}, {to_a, to_b});
  measure("masked_l1", "a, b, mask", {a, b, mask}, {to_a, to_b});
  measure("masked_l2", "a, b, mask", {a, b, mask}, {to_a, to_b});
  measure("masked_huber", "a, b, mask, 0.5", {a, b, mask}, {to_a, to_b});
  measure("masked_mean", "x, mask", {floats("x", 0, 8, 1e-3), mask}, {conditioned("x", 8 * u)});
  measure("pyramid", "a, b, 4", {a, b}, {to_a, to_b});
  measure("roughness", "a", {a}, {to_a});
  measure("psnr", "a, b", {a, b}, {to_a});
  measure("masked_psnr", "a, b, mask", {a, b, mask}, {to_a});
  const Operand m = floats("m", 0, 1, 1e-3), n = floats("n", 0, 1, 1e-3);
  measure("iou", "m, n", {m, n}, {conditioned("m", 8 * u), conditioned("n", 8 * u)});
  measure("masked_iou", "m, n, mask", {m, n, mask}, {conditioned("m", 8 * u), conditioned("n", 8 * u)});
  const std::string terms = "sum(abs(a * b), over = (x, y)) / sum(a * a, over = (x, y))";
  for (const bool masked : {false, true}) {
    const std::string name = masked ? "masked_gain" : "gain";
    all.push_back(
        {.name = "loss." + name,
         .part = {},
         .result = "vec3[1]",
         .operands = masked ? Operands{a, b, mask} : Operands{a, b},
         .value = "loss." + name + (masked ? "(a, b, mask)" : "(a, b)"),
         .directions = {over(
                            "value", 2 * kSum + 4 * u,
                            masked ? "sum(mask * abs(a * b), over = (x, y)) / sum(mask * a * a, over = (x, y))" : terms,
                            "the sum of the terms' sizes", why),
                        conditioned("a", 8 * u), conditioned("b", 8 * u)},
         .whole = true});
  }
  return all;
}

std::vector<Function> textures() {
  const Operand uv = vectors("uv", -0.5, 1.5, 1e-6, "vec2");
  const Operand image = whole(vectors("image", 0, 1, 1e-3), "[16, 8]");
  // Contrast, and what the coordinates' own rounding does to the weights.
  const std::string scale = "(max(image) - min(image)) * (1.0 + dot(abs(uv), vec2(16.0, 8.0)))";
  const std::string text = "contrast, times 1 + |uv| in texels";
  const std::string why = "the 4u set beforehand, and the coordinates' own rounding";
  std::vector<Function> all;
  const auto read = [&](const std::string& name, const std::string& value, Directions directions, Operands more = {}) {
    all.push_back({.name = "texture." + name,
                   .part = {},
                   .result = "vec3",
                   .operands = join({{image, uv}, std::move(more)}),
                   .value = value,
                   .directions = std::move(directions)});
  };
  const auto apart = [](Direction d) {
    d.except = "any(lessThan(abs(fract(uv * vec2(16.0, 8.0) + 0.5) - 0.5), vec2(1e-5)))";
    d.except_text = "borders of texels";
    return d;
  };
  const Direction value = over("value", 4 * u, scale, text, why);
  const Direction to_image = l2("image", 1e-6, "the bound set beforehand for dot products");
  // Borders between which four texels count, on so many levels.
  const auto slope = [&](int levels) {
    Direction d =
        over("uv", 4 * u, "dot(abs(g), max(image) - min(image)) * 16.0 * (1.0 + dot(abs(uv) + 1.0, vec2(16.0, 8.0)))",
             "contrast, times the texture's size and |uv| + the size, in texels, times |adjoint|", why);
    for (int k = 0; k < levels; ++k) {
      const std::string size = "vec2(" + std::to_string(16 >> k) + ".0, " + std::to_string(8 >> k) + ".0)";
      d.except += std::string(k > 0 ? " || " : "") + "any(lessThan(abs(fract(uv * " + size + ") - 0.5), vec2(1e-5)))";
    }
    d.except_text = "middles of texels, where others begin to count";
    return d;
  };
  read("nearest", "texture.nearest(image, uv)",
       {
           apart(equal()),
       });
  all.back().transposed = {"image"};
  read("bilinear", "texture.bilinear(image, uv)", {value, to_image, slope(1)});
  read("bilinear_repeat", "texture.bilinear_repeat(image, uv)",
       {over("value", 4 * u, "(max(image) - min(image)) * (1.0 + dot(abs(uv) + 1.0, vec2(16.0, 8.0)))",
             "contrast, times 1 + |uv| + the texture's size, in texels", why),
        to_image, slope(1)});
  read("trilinear", "texture.trilinear(texture.pyramid(image, 3), uv, level)",
       {over("value", 4 * u, scale, text, why), to_image, slope(3),
        conditioned("level", 64 * u, "like the coordinates")},
       {floats("level", -1, 4, 1e-6)});
  Direction anisotropic = conditioned("value", 64 * u, "like trilinear, several times");
  // Each read's slope is a difference of texels, and the next one's takes the same texel off again: what is left is not
  // what they are rounded to. Places are half of `along` from uv at most, 12 texels of the 24 that the scale counts
  // beside it.
  Direction to_places = slope(0);
  to_places.except = "middle < 1e-5";
  to_places.except_text = "middles of texels, where others begin to count";
  // Slopes of reads on both sides of the middle cancel; where the axis points is ill-conditioned for near circles.
  const auto to_axis = [&](const std::string& of) {
    return over(of, 16 * u,
                "dot(abs(g), max(image) - min(image)) * (1.0 + dot(abs(uv) + 1.0, vec2(16.0, 8.0))) * bent * bent",
                "contrast, times 1 + |uv| + the texture's size, in texels, times |adjoint|, over the square of how far "
                "the footprint is from a circle",
                "the coordinates' own rounding");
  };
  Direction to_dx = to_axis("dx"), to_dy = to_axis("dy");
  for (Direction* d : {&anisotropic, &to_places, &to_dx, &to_dy}) {
    d->except += (d->except.empty() ? "" : " || ") + std::string("abs(fract(ratio + 0.4999) - 0.5) < 1e-3");
    d->except_text += (d->except_text.empty() ? "" : ", and ") + std::string("where the number of reads changes");
  }
  const Operands axes = {vectors("dx", -12, 12, 1e-2, "vec2"), vectors("dy", -12, 12, 1e-2, "vec2")};
  all.push_back({.name = "texture.anisotropic",
                 .part = {},
                 .result = "vec3",
                 .operands = join({{image, uv}, axes}),
                 .value = "texture.anisotropic(texture.pyramid(image, 3), uv, dx, dy)",
                 .directions = {anisotropic, to_image, to_places, to_dx, to_dy},
                 .before = "  let (along, wide) = texture.footprint(dx, dy);\n"
                           "  let ratio = clamp(max(length(along), 1.0) / max(wide, 1.0), 1.0, 8.0);\n"
                           "  let (r, s) = (vec2(dx.x, dy.x), vec2(dx.y, dy.y));\n"
                           "  let round = length(vec2(0.5 * (dot(r, r) - dot(s, s)), dot(r, s)));\n"
                           "  let bent = 1.0 + dot(along, along) / max(round, 1e-12);\n"
                           "  let reads = ceil(ratio - 1e-4);\n"
                           "  let middle = reduce(min, k in 0..24) {\n"
                           "    let place = uv + ((float(k % 8) + 0.5) / reads - 0.5) * along / vec2(16.0, 8.0);\n"
                           "    let near = abs(fract(place * vec2(16.0, 8.0) / exp2(float(k / 8))) - 0.5);\n"
                           "    min(near.x, near.y)\n"
                           "  };\n"});
  all.push_back({.name = "texture.footprint",
                 .part = "axis",
                 .result = "vec2",
                 .operands = axes,
                 .value = "texture.footprint(dx, dy).0",
                 .directions = all_conditioned(32 * u, 64 * u, {"dx", "dy"})});
  all.push_back({.name = "texture.footprint",
                 .part = "width",
                 .result = "float",
                 .operands = axes,
                 .value = "texture.footprint(dx, dy).1",
                 .directions = all_conditioned(32 * u, 64 * u, {"dx", "dy"})});
  all.push_back({.name = "texture.between",
                 .part = {},
                 .result = "vec3",
                 .operands = {image,
                              {.name = "low", .type = "ivec2", .low = 0, .high = 7},
                              {.name = "high", .type = "ivec2", .low = 0, .high = 7},
                              vectors("t", 0, 1, 1e-6, "vec2")},
                 .value = "texture.between(image, low, high, t)",
                 .directions = {over("value", 4 * u, "max(image) - min(image)", "contrast", kBeforehand), to_image,
                                over("t", 4 * u, "dot(abs(g), max(image) - min(image))", "contrast times |adjoint|",
                                     kBeforehand)}});
  const Operand large = vectors("image", 0, 1, 1e-3);
  all.push_back({.name = "texture.halve",
                 .part = {},
                 .result = "vec3[32, 32]",
                 .operands = {large},
                 .value = "texture.halve(image)",
                 .directions = {relative("value", 4 * u, kFew), relative("image", 2 * u, kFew)},
                 .whole = true});
  all.push_back({.name = "texture.pyramid",
                 .part = {},
                 .result = "vec3[8, 8]",
                 .operands = {large},
                 .value = "texture.pyramid(image, 4)[3]",
                 .directions = {relative("value", 8 * u, kFew), relative("image", 4 * u, kFew)},
                 .whole = true});
  all.push_back({.name = "texture.bilinear_inverse",
                 .part = {},
                 .result = "vec3",
                 .operands = {image, uv, {.name = "table", .type = "int", .low = 0, .high = 4096, .extent = "[16, 8]"}},
                 .value = "texture.bilinear_inverse(image, uv, table)",
                 .directions = {value, to_image},
                 .whole = true});
  return all;
}

}  // namespace

std::vector<Function> image_functions() {
  std::vector<Function> all = losses();
  for (Function& f : textures()) all.push_back(std::move(f));
  return all;
}

}  // namespace dr::accuracy::library
