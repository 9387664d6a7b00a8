// SPDX-License-Identifier: Apache-2.0
// std.nn, std.points, std.splat, and the rays and lenses of std.camera.
#include "tests/device/accuracy/library_table.h"

namespace dr::accuracy::library {

namespace {

constexpr const char* kDot = "the bound set beforehand for dot products";

std::vector<Function> networks() {
  const Operand x = whole(floats("x", -1, 1, 1e-3), "[6, 150]"),
                weight = whole(floats("weight", -1, 1, 1e-3), "[5, 6]"),
                bias = whole(floats("bias", -1, 1, 1e-3), "[5]");
  const Direction to_x = l2("x", 1e-6, kDot), to_weight = l2("weight", 1e-6, kDot), to_bias = l2("bias", 1e-6, kDot);
  std::vector<Function> all;
  const auto add = [&](const std::string& name, const std::string& result, const std::string& arguments,
                       Operands operands, Directions directions) {
    all.push_back({.name = "nn." + name,
                   .part = {},
                   .result = result,
                   .operands = std::move(operands),
                   .value = "nn." + name + "(" + arguments + ")",
                   .directions = std::move(directions),
                   .whole = true});
  };
  add("dense", "float[5, 150]", "x, weight, bias", {x, weight, bias},
      {over("value", 8 * u, "7.0 + 0.0 * y", "the sum of the largest terms", kFew), to_x, to_weight, to_bias});
  add("sine", "float[5, 150]", "x, weight, bias, 3.0", {x, weight, bias},
      {over("value", 24 * u, "7.0 + 0.0 * y", "the sum of the largest terms", "three times those of `dense`"),
       l2("x", 4e-6, "a cosine of three times those of `dense`"),
       l2("weight", 4e-6, "a cosine of three times those of `dense`"),
       l2("bias", 4e-6, "a cosine of three times those of `dense`")});
  const Operand right = whole(floats("right", -1, 1, 1e-3), "[7, 6]");
  add("matmul", "float[7, 150]", "x, right", {x, right},
      {over("value", 8 * u, "6.0 + 0.0 * y", "the sum of the largest terms", kFew), to_x, l2("right", 1e-6, kDot)});
  const Operand features = whole(floats("features", -1, 1, 1e-3), "[14, 9, 3]"),
                kernel = whole(floats("kernel", -1, 1, 1e-3), "[4, 3, 6]");
  add("conv", "float[14, 9, 2]", "features, kernel", {features, kernel},
      {over("value", 16 * u, "36.0 + 0.0 * y", "the sum of the largest terms", kFew), l2("features", 1e-6, kDot),
       l2("kernel", 1e-6, kDot)});
  add("positional", "float[36, 150]", "x, 3", {x},
      {over("value", 16 * u, "1.0 + 0.0 * y", "1", "angles up to 4 pi, rounded"), l2("x", 2e-6, "angles, rounded")});
  add("places", "float[2, 63]", "9, 7", {floats("unused", 0, 1)}, {relative("value", 2 * u, kFew)});
  add("picture", "vec3[15, 10]", "x, 15, 10", {x}, {equal(), l2("x", 0, "nothing is rounded")});
  add("random_weights", "float[5, 6]", "5, 6, 0.3, 7u", {floats("unused", 0, 1)},
      {over("value", 2 * u, "0.3 + 0.0 * y", "the largest", kFew)});
  all.push_back({.name = "nn.relu",
                 .part = {},
                 .result = "float",
                 .operands = {floats("c", -4, 4, 1e-6)},
                 .value = "nn.relu(c)",
                 .directions = {equal(), equal("c")}});
  return all;
}

std::vector<Function> clouds() {
  const Operand a = whole(vectors("a", -1, 1, 1e-3), "[40]"), b = whole(vectors("b", -1, 1, 1e-3), "[30]");
  std::vector<Function> all;
  // Whichever of two is taken for the nearer one, the distance is the same.
  all.push_back({.name = "points.nearest_square",
                 .part = {},
                 .result = "float[40]",
                 .operands = {a, b},
                 .value = "points.nearest_square(a, b)",
                 .directions = {relative("value", 8 * u, kFew), l2("a", 1e-6, kDot), l2("b", 1e-6, kDot)},
                 .whole = true});
  all.push_back({.name = "points.chamfer",
                 .part = {},
                 .result = "float[1]",
                 .operands = {a, b},
                 .value = "points.chamfer(a, b)",
                 .directions = {relative("value", 1e-6, kBeforehand), l2("a", 1e-6, kDot), l2("b", 1e-6, kDot)},
                 .whole = true});
  return all;
}

std::vector<Function> splats() {
  const Operands shape = {vectors("size", 0.5, 8, 1e-2, "vec2"), floats("angle", -3, 3, 1e-3)};
  std::vector<Function> all;
  all.push_back({.name = "splat.ellipse",
                 .part = {},
                 .result = "vec3",
                 .operands = shape,
                 .value = "splat.ellipse(size, angle)",
                 .directions = {over("value", 8 * u, "dot(size, size)", "the sum of both variances", kFew),
                                over("size", 16 * u, "length(g) * length(size)", "|adjoint| times the size", kFew),
                                over("angle", 32 * u, "length(g) * dot(size, size)",
                                     "|adjoint| times the sum of both variances", kFew)}});
  all.push_back({.name = "splat.precision",
                 .part = {},
                 .result = "vec3",
                 .operands = {vectors("size", 0.5, 8, 1e-2, "vec2"), floats("angle_", -3, 3, 1e-3),
                              made("covariance", "vec3", "splat.ellipse(size, angle_)")},
                 .value = "splat.precision(covariance)",
                 .directions = {conditioned("value", 8 * u), conditioned("covariance", 32 * u)}});
  all.push_back({.name = "splat.share",
                 .part = {},
                 .result = "float",
                 .operands = {vectors("p", 0, 16, 1e-2, "vec2"), vectors("center", 0, 16, 1e-2, "vec2"),
                              vectors("size_", 2, 8, 1e-2, "vec2"), floats("angle_", -3, 3, 1e-3),
                              made("shape", "vec3", "splat.precision(splat.ellipse(size_, angle_))"),
                              floats("opacity", 0, 0.9, 1e-3)},
                 .value = "splat.share(p, center, shape, opacity)",
                 .directions = {conditioned("value", 32 * u), conditioned("p", 64 * u), conditioned("center", 64 * u),
                                conditioned("shape", 64 * u), conditioned("opacity", 32 * u)}});
  const Operands nine = {whole(vectors("center", 2, 14, 1e-2, "vec2"), "[9]"),
                         whole(vectors("size_", 1, 3, 1e-2, "vec2"), "[9]"),
                         whole(floats("angle_", -3, 3, 1e-3), "[9]"),
                         made("covariance", "vec3", "splat.ellipse(size_, angle_)", "[9]"),
                         whole(vectors("color", 0, 1, 1e-3), "[9]"),
                         whole(floats("opacity", 0.1, 0.9, 1e-3), "[9]")};
  const std::string why = "nine factors, each with the rounding of its place";
  // Depths that no two share: the order is no matter of rounding.
  const std::string depth = "  let depth = 0.05 + 0.1 * float((coord(9).x * 4) % 9);\n";
  all.push_back({.name = "splat.gaussians",
                 .part = {},
                 .result = "vec3[16, 16]",
                 .operands = nine,
                 .value = "splat.gaussians(center, covariance, depth, color, opacity, 16, 16, nearest = 9).color",
                 .directions = {over("value", 1e-5, "1.0 + 0.0 * y.x", "1", why), l2("center", 1e-5, why),
                                l2("covariance", 1e-5, why), l2("color", 1e-5, why), l2("opacity", 1e-5, why)},
                 .before = depth,
                 .whole = true});
  all.push_back({.name = "splat.discs",
                 .part = {},
                 .result = "vec3[16, 16]",
                 .operands = {nine[0], whole(floats("radius", 1, 4, 1e-2), "[9]"), nine[4]},
                 .value = "splat.discs(center, radius, depth, color, 16, 16, nearest = 9).color",
                 .directions = {over("value", 1e-5, "1.0 + 0.0 * y.x", "1", why), l2("center", 1e-5, why),
                                l2("radius", 1e-5, why), l2("color", 1e-5, why)},
                 .before = depth,
                 .whole = true});
  return all;
}

std::vector<Function> lenses() {
  const std::string view =
      "  let view = camera.perspective(45.0, 1.5, 0.5, 20.0) * camera.look_at(vec3(1.0, 2.0, 4.0));\n";
  const Operands lens = {vectors("p", -0.7, 0.7, 1e-3, "vec2"), vectors("radial", -0.1, 0.1, 1e-3),
                         vectors("tangential", -0.02, 0.02, 1e-4, "vec2"), vectors("divisor", -0.1, 0.1, 1e-3)};
  Operands behind = {vectors("p_", -0.5, 0.5, 1e-3, "vec2"), lens[1], lens[2], lens[3],
                     made("p", "vec2", "camera.distort(p_, radial, tangential, divisor)")};
  const std::string of_length = "length(g)", text = "|adjoint|";
  std::vector<Function> all;
  for (const char* way : {"distort", "undistort"}) {
    const bool back = way[0] == 'u';
    const double bound = back ? 32 * u : 16 * u;
    const std::string why = back ? "a solution is as near as the residual of its last step" : kFew;
    Directions directions = {over("value", bound, "1.0 + 0.0 * y.x", "1", why)};
    for (const char* o : {"p", "radial", "tangential", "divisor"})
      directions.push_back(over(o, 4 * bound, of_length, text, why));
    all.push_back({.name = std::string("camera.") + way,
                   .part = {},
                   .result = "vec2",
                   .operands = back ? behind : lens,
                   .value = std::string("camera.") + way + "(p, radial, tangential, divisor)",
                   .directions = directions,
                   .domain = "a lens that bends by less than a third"});
  }
  const std::string why = "the inverse of a matrix whose condition is about 1,000";
  const Operand pixel = vectors("pixel", 0, 64, 1e-2, "vec2");
  all.push_back({.name = "camera.unproject",
                 .part = {},
                 .result = "vec3",
                 .operands = {pixel, floats("depth", 0, 0.9, 1e-3)},
                 .value = "camera.unproject(view, pixel, depth, 64, 64)",
                 .directions = {over("value", 1e-4, "1.0 + length(y)", "1 + |result|", why)},
                 .before = view,
                 .transposed = {"pixel", "depth"}});
  all.push_back({.name = "camera.ray",
                 .part = {},
                 .result = "vec3",
                 .operands = {pixel},
                 .value = "camera.ray(view, pixel, 64, 64).direction",
                 .directions = {over("value", 16 * u, "1.0 + 0.0 * y.x", "1", kFew)},
                 .before = view,
                 .transposed = {"pixel"}});
  return all;
}

}  // namespace

std::vector<Function> network_functions() {
  std::vector<Function> all;
  for (auto&& part : {networks(), clouds(), splats(), lenses()}) all.insert(all.end(), part.begin(), part.end());
  return all;
}

}  // namespace dr::accuracy::library
