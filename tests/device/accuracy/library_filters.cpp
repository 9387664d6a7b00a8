// SPDX-License-Identifier: Apache-2.0
// std.image and std.solve.
#include "tests/device/accuracy/library_table.h"

namespace dr::accuracy::library {

namespace {

constexpr double kGradient = 1e-6;  // the bound set beforehand for dot products

std::vector<Function> picture_filters() {
  const Operand image = whole(vectors("photo", 0, 1, 1e-3), "[24, 18]"),
                a = whole(vectors("a", 0, 1, 1e-3), "[24, 18]"), b = whole(vectors("b", 0, 1, 1e-3), "[24, 18]");
  const Operand kernel = whole(floats("kernel", -1, 1, 1e-3), "[4, 3]");
  const Operand sigma = whole(floats("sigma", 0.5, 3, 1e-2), "[1]");
  const auto one = [](double bound, const std::string& why = kFew) {
    return over("value", bound, "1.0 + 0.0 * y", "1", why);
  };
  const Direction to_image = l2("photo", kGradient, "the bound set beforehand for dot products");
  std::vector<Function> all;
  const auto add = [&](const std::string& name, const std::string& part, const std::string& result,
                       const std::string& arguments, Operands operands, Directions directions) {
    all.push_back({.name = "image." + name,
                   .part = part,
                   .result = result,
                   .operands = std::move(operands),
                   .value = "image." + name + "(" + arguments + ")",
                   .directions = std::move(directions),
                   .whole = true});
  };
  for (const char* border : {"zero", "clamp", "repeat", "mirror"})
    add("convolve", border, "vec3[24, 18]", std::string("photo, kernel, image.") + border, {image, kernel},
        {over("value", 16 * u, "sum(abs(kernel)) + 0.0 * y.x", "the kernel's sum", "twelve terms"), to_image,
         l2("kernel", kGradient, "the bound set beforehand for dot products")});
  add("padded", "", "vec3[28, 23]", "photo, 1, 3, 2, 3, image.mirror", {image}, {equal(), to_image});
  add("correlated", "", "vec3[21, 16]", "photo, kernel", {image, kernel},
      {over("value", 16 * u, "sum(abs(kernel)) + 0.0 * y.x", "the kernel's sum", "twelve terms"), to_image,
       l2("kernel", kGradient, "the bound set beforehand for dot products")});
  add("gaussian", "", "float[9]", "sigma, 4", {sigma},
      {one(16 * u), over("sigma", 64 * u, "sum(abs(g)) * (1.0 + 1.0 / sigma)", "the adjoints' sum, times 1 + 1 / sigma",
                         "sums of nine terms that cancel")});
  add("blur", "", "vec3[24, 18]", "photo, sigma, 4", {image, sigma},
      {over("value", 32 * u, "1.0 + 0.0 * y.x", "1", "eighteen terms"), to_image});
  for (const char* way : {"shrink", "resize"}) {
    add(way, "smaller", "vec3[7, 5]", "photo, 7, 5", {image},
        {over("value", 32 * u, "1.0 + 0.0 * y.x", "1", "sums of up to 64 terms"), to_image});
    add(way, "larger", "vec3[31, 40]", "photo, 31, 40", {image},
        {over("value", 32 * u, "1.0 + 0.0 * y.x", "1", kFew), to_image});
  }
  for (const char* way : {"right_difference", "lower_difference", "slope_x", "slope_y"})
    add(way, "", "vec3[24, 18]", "photo", {image},
        {over("value", 4 * u, "1.0 + 0.0 * y.x", "1", "a difference"), to_image});
  add("total_variation", "", "float[1]", "photo", {image}, {relative("value", 1e-6, kBeforehand), to_image});
  const std::string cancels = "variances are differences of means of squares: up to 1 / 9e-4 times their rounding";
  add("similarity", "", "vec3[24, 18]", "a, b", {a, b},
      {over("value", 1e-4, "1.0 + 0.0 * y.x", "1", cancels), l2("a", 1e-4, cancels), l2("b", 1e-4, cancels)});
  add("ssim", "", "float[1]", "a, b", {a, b}, {one(1e-5, cancels), l2("a", 1e-4, cancels), l2("b", 1e-4, cancels)});
  for (const char* way : {"to_srgb", "from_srgb"})
    all.push_back({.name = std::string("image.") + way,
                   .part = {},
                   .result = "float",
                   .operands = {floats("c", -1, 4, 1e-6)},
                   .value = std::string("image.") + way + "(c)",
                   .directions = {relative("value", 16 * u, "a power's, and a subtraction of 0.055 or an addition"),
                                  relative("c", 16 * u, "a power's")}});
  return all;
}

// Systems and residuals of nine numbers.
std::vector<Function> solvers() {
  const Operand a = whole(floats("a", -1, 1, 1e-3), "[9, 9]"), b = whole(floats("b", -1, 1, 1e-3), "[9]"),
                x = whole(floats("x", -1, 1, 1e-3), "[9]");
  const std::string matrix =
      "  let i = coord(9, 9);\n"
      "  let m = reduce(sum, k in 0..9) { a.at(ivec2(k, i.x)) * a.at(ivec2(k, i.y)) } + (if i.x == i.y { 4.0 } else { "
      "0.0 });\n";
  // A residual that is nearly linear, and whose tangent has that matrix's condition.
  const std::string residual =
      "  let p = coord(9, 2);\n"
      "  let r = fn(v) { if p.y == 0 { 2.0 * v.at(p.x) - b.at(p.x) } else { reduce(sum, k in 0..9) { 0.3 * "
      "a.at(ivec2(k, p.x)) * sin(v.at(k)) } } };\n";
  const std::string domain = "symmetric matrices of 9 x 9 with a condition below 10";
  const std::string why = "sums of nine terms, times the condition";
  std::vector<Function> all;
  const auto add = [&](const std::string& name, const std::string& result, const std::string& value, Operands operands,
                       Directions directions, const std::string& before) {
    all.push_back({.name = "solve." + name,
                   .part = {},
                   .result = result,
                   .operands = std::move(operands),
                   .value = value,
                   .directions = std::move(directions),
                   .before = before,
                   .domain = domain,
                   .whole = true});
  };
  const Direction value = l2("value", 1e-6, why), to_a = l2("a", 4e-6, why), to_b = l2("b", 4e-6, why);
  add("cholesky", "float[9]", "solve.cholesky(m, b)", {a, b}, {value, to_a, to_b}, matrix);
  add("conjugate_gradients", "float[9]",
      "solve.conjugate_gradients(fn(v) { reduce(sum, k in 0..9) { m.at(ivec2(coord(9).x, k)) * v.at(k) } }, b, 0.0 * "
      "b, 9)",
      {a, b}, {value, to_a, to_b}, matrix);
  add("products", "float[9, 9]", "solve.products(j)", {whole(vectors("j", -1, 1, 1e-3), "[12, 30, 9]")},
      {l2("value", 1e-6, "the bound set beforehand for dot products"),
       l2("j", 1e-6, "the bound set beforehand for dot products")},
      {});
  add("damped", "float[9, 9]", "solve.damped(a, d)", {a, whole(floats("d", 0, 4, 1e-6), "[1]")},
      {relative("value", 2 * u, kFew), l2("a", 2 * u, kFew)}, {});
  add("squares", "float[1]", "solve.squares(a)", {a}, {relative("value", 1e-6, kBeforehand), l2("a", 2 * u, kFew)}, {});
  add("normal_equations", "float[9]", "solve.normal_equations(r, x).1", {a, b, x}, {value}, residual);
  all.back().transposed = {"a", "b", "x"};
  add("gauss_newton", "float[9]", "solve.gauss_newton(r, x)", {a, b, x}, {l2("value", 4e-6, why)}, residual);
  all.back().transposed = {"a", "b", "x"};
  // Light around a ball: the normal equations alone would be off by 1e-4.
  const std::string light =
      "  let p = (vec2(coord(64, 64).xy) + 0.5) / 32.0 - 1.0;\n"
      "  let n = vec3(p.x, -p.y, sqrt(max(1.0 - dot(p, p), 0.0)));\n"
      "  let c = 3 * coord(9).x;\n"
      "  let drawn = fn(v) { light.irradiance(vec3(v.at(c), v.at(c + 1), v.at(c + 2)), n) * (if dot(p, p) < 1.0 { 1.0 "
      "} "
      "else { 0.0 }) };\n"
      "  let r = fn(v) { drawn(v) - drawn(t) };\n";
  add("gauss_newton", "float[27]", "solve.gauss_newton(r, x)",
      {whole(floats("x", -1, 1, 1e-3), "[27]"), whole(floats("t", -1, 1, 1e-3), "[27]")},
      {l2("value", 2e-6, "one rounding of the numbers, times the condition of what is drawn")}, light);
  all.back().part = "light of 27 numbers";
  all.back().domain = "numbers within -1 and 1, from others";
  return all;
}

}  // namespace

std::vector<Function> filter_functions() {
  std::vector<Function> all = picture_filters(), more = solvers();
  all.insert(all.end(), more.begin(), more.end());
  return all;
}

}  // namespace dr::accuracy::library
