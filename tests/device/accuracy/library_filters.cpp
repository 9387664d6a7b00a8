// SPDX-License-Identifier: Apache-2.0
// std.image.
#include "tests/device/accuracy/library_table.h"

namespace dr::accuracy::library {

namespace {

constexpr double kGradient = 1e-6;  // the design's, as a dot product

std::vector<Function> filters() {
  const Operand image = whole(vectors("image", 0, 1, 1e-3), "[24, 18]"),
                a = whole(vectors("a", 0, 1, 1e-3), "[24, 18]"), b = whole(vectors("b", 0, 1, 1e-3), "[24, 18]");
  const Operand kernel = whole(floats("kernel", -1, 1, 1e-3), "[4, 3]");
  const Operand sigma = whole(floats("sigma", 0.5, 3, 1e-2), "[1]");
  const auto one = [](double bound, const std::string& why = kFew) {
    return over("value", bound, "1.0 + 0.0 * y", "1", why);
  };
  const Direction to_image = l2("image", kGradient, "the design's, as a dot product");
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
    add("convolve", border, "vec3[24, 18]", std::string("image, kernel, image.") + border, {image, kernel},
        {over("value", 16 * u, "sum(abs(kernel)) + 0.0 * y.x", "the kernel's sum", "twelve terms"), to_image,
         l2("kernel", kGradient, "the design's, as a dot product")});
  add("padded", "", "vec3[28, 23]", "image, 1, 3, 2, 3, image.mirror", {image}, {equal(), to_image});
  add("correlated", "", "vec3[21, 16]", "image, kernel", {image, kernel},
      {over("value", 16 * u, "sum(abs(kernel)) + 0.0 * y.x", "the kernel's sum", "twelve terms"), to_image,
       l2("kernel", kGradient, "the design's, as a dot product")});
  add("gaussian", "", "float[9]", "sigma, 4", {sigma},
      {one(16 * u), over("sigma", 64 * u, "sum(abs(g)) * (1.0 + 1.0 / sigma)", "the adjoints' sum, times 1 + 1 / sigma",
                         "sums of nine terms that cancel")});
  add("blur", "", "vec3[24, 18]", "image, sigma, 4", {image, sigma},
      {over("value", 32 * u, "1.0 + 0.0 * y.x", "1", "eighteen terms"), to_image});
  for (const char* way : {"shrink", "resize"}) {
    add(way, "smaller", "vec3[7, 5]", "image, 7, 5", {image},
        {over("value", 32 * u, "1.0 + 0.0 * y.x", "1", "sums of up to 64 terms"), to_image});
    add(way, "larger", "vec3[31, 40]", "image, 31, 40", {image},
        {over("value", 32 * u, "1.0 + 0.0 * y.x", "1", kFew), to_image});
  }
  for (const char* way : {"right_difference", "lower_difference", "slope_x", "slope_y"})
    add(way, "", "vec3[24, 18]", "image", {image},
        {over("value", 4 * u, "1.0 + 0.0 * y.x", "1", "a difference"), to_image});
  add("total_variation", "", "float[1]", "image", {image}, {relative("value", 1e-6, kDesign), to_image});
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

}  // namespace

std::vector<Function> filter_functions() { return filters(); }

}  // namespace dr::accuracy::library
