// SPDX-License-Identifier: Apache-2.0
// std.optim and std.random, and the functions of an element of std.loss and std.texture.
#include "tests/device/accuracy/library_table.h"

namespace dr::accuracy::library {

namespace {

// One step of an optimizer from any memory: how far `x`, which is 0, goes.
Function optimizer(const std::string& name, Operands memory, const std::string& arguments, Directions directions,
                   const std::string& domain) {
  Function f{.name = "optim." + name,
             .part = {},
             .result = {},
             .operands = {},
             .value = {},
             .directions = std::move(directions),
             .domain = domain};
  f.operands = join({{made("zero_", "float", "0.0"), made("x", "float", "zero_")}, std::move(memory)});
  f.statement = "  minimize sum($x * $slope) over $x with optim." + name + "(" + arguments + ");\n";
  return f;
}

// An optimizer's memory, and the same number where expressions can name it.
Operand memory(const std::string& name, const std::string& from) {
  Operand state = made(name, "float", from);
  state.leaf = "f#.x#_x." + name;
  return state;
}

std::vector<Function> optimizers() {
  const Operands slope = {floats("slope", -1e30, 1e30, 1e-30)};
  const Operands v = {floats("old_v", -1e30, 1e30, 1e-30), memory("v", "old_v")};
  // The mean of past slopes is not much larger than the root of their mean square.
  const Operands m = {floats("old_s", 0, 1e30, 1e-30), floats("ratio_", -8, 8, 1e-6),
                      made("old_m", "float", "old_s * ratio_"), memory("s", "old_s"), memory("m", "old_m")};
  const std::string t = "runs 1 … 2^20, any memory";
  // The update's two parts may cancel.
  const std::string moment = "(0.9 * abs($old_m) + 0.1 * abs($slope))";
  const std::string change =
      "0.01 * " + moment +
      " / (1.0 - pow(0.9, float(step_index + 1))) / (sqrt((0.999 * $old_s * $old_s + 0.001 * $slope * $slope) / "
      "(1.0 - pow(0.999, float(step_index + 1)))) + 1e-15)";
  return {
      optimizer("sgd", slope, "rate = 0.01", {relative("next x", 2 * u, kFew)}, ""),
      optimizer("momentum", join({slope, v}), "rate = 0.01",
                {over("next x", 4 * u, "0.01 * (0.9 * abs($old_v) + abs($slope))", "the update's terms' sizes", kFew),
                 over("next v", 4 * u, "0.9 * abs($old_v) + abs($slope)", "the terms' sizes", kFew)},
                ""),
      optimizer("adam", join({slope, m}), "rate = 0.01",
                {over("next x", 1e-5, change, "the update, its terms' sizes", kBeforehand),
                 over("next m", 4 * u, moment, "the terms' sizes", kFew), relative("next s", 8 * u, kFew)},
                t),
      optimizer("smooth_adam", join({slope, m}), "fn(d) { d }, rate = 0.01",
                {over("next x", 1e-5, change, "the update, its terms' sizes", kBeforehand),
                 over("next m", 4 * u, moment, "the terms' sizes", kFew), relative("next s", 8 * u, kFew)},
                t),
      optimizer("adamw", join({slope, m}), "rate = 0.01, decay = 0.1",
                {over("next x", 1e-5, change, "the update, its terms' sizes", kBeforehand),
                 over("next m", 4 * u, moment, "the terms' sizes", kFew), relative("next s", 8 * u, kFew)},
                t),
  };
}

std::vector<Function> schedules() {
  const Operand steps = floats("steps", 1, 1e6);
  const std::string domain = "runs 1 … 2^20";
  const auto schedule = [&](const std::string& name, double low, double bound, bool ends) {
    Function f{.name = "optim." + name,
               .part = {},
               .result = "float",
               .operands = {floats("first", low, 1e3, 1e-6), floats("last", low, 1e3, 1e-6), steps},
               .value = "optim." + name + "(first, last, steps)",
               .directions = all_conditioned(bound, 2 * bound, {"first", "last"}),
               .domain = domain};
    if (!ends) {
      f.operands = {floats("first", low, 1e3, 1e-6), steps};
      f.value = "optim." + name + "(first, steps)";
      f.directions = all_conditioned(bound, 2 * bound, {"first"});
    }
    return f;
  };
  Function exponential = schedule("exponential", 1e-6, 16 * u, true);
  // The exponent e = log(last / first) progress is a product of quotients, of 2.5 last places each, and a logarithm's:
  // it is off by 8 u |e|, and the power by as much of itself.
  exponential.before = "  let part = optim.progress(steps);\n  let size = 1.0 + abs(log(last / first) * part);\n";
  const char* const kExponent = "the exponent's own rounding, by two quotients";
  exponential.directions = {
      over("value", 8 * u, "size * y", "(1 + |e|) y, e the exponent", kExponent),
      over("first", 16 * u, "size * abs(g * y / first)", "(1 + |e|) |y / first| |adjoint|", kExponent),
      over("last", 16 * u, "size * abs(g * part * y / last)", "(1 + |e|) progress |y / last| |adjoint|", kExponent)};
  Function cosine = schedule("cosine", -1e3, 8 * u, true);
  cosine.before = "  let angle = radians(90.0) * optim.progress(steps);\n";
  cosine.directions[0] = over("value", 8 * u, "(cos(angle) + 1e-7) * abs(first) + sin(angle) * abs(last)",
                              "cos |first| + sin |last| + 2 u |first|", "the angle's own rounding");
  cosine.directions[1] = over("first", 8 * u, "abs(g)", "|adjoint|", "what is left of 1 at the end");
  return {{.name = "optim.progress",
           .part = {},
           .result = "float",
           .operands = {steps},
           .value = "optim.progress(steps)",
           .directions = {relative("value", 5 * u, "a quotient, of 2.5 last places")},
           .domain = domain},
          schedule("linear", -1e3, 4 * u, true),
          exponential,
          cosine,
          schedule("warmup", -1e3, 4 * u, false)};
}

std::vector<Function> clipping() {
  const Operand g = vectors("v", -1e37, 1e37, 1e-36), limit = floats("limit", 1e-6, 1e6);
  return {
      {.name = "optim.hypot",
       .part = {},
       .result = "float",
       .operands = {floats("a", 0, 1e37, 1e-36), floats("b", 0, 1e37, 1e-36)},
       .value = "optim.hypot(a, b)",
       .directions = {relative("value", 8 * u, kBeforehand)},
       .transposed = {"a", "b"}},
      {.name = "optim.clip_length",
       .part = {},
       .result = "vec3",
       .operands = {vectors("v", -1e30, 1e30, 1e-30), limit},
       .value = "optim.clip_length(v, limit)",
       .directions = {relative("value", 16 * u, "a length, a quotient and a product")},
       .transposed = {"v", "limit"}},
      {.name = "optim.clip_norm",
       .part = {},
       .result = "vec3",
       .operands = {vectors("v", -1e30, 1e30, 1e-30), whole(floats("limit", 1e-6, 1e6), "[1]")},
       .value = "optim.clip_norm(v, limit)",
       .directions = {relative("value", 16 * u, "like clip_length")},
       .transposed = {"v", "limit"}},
      {.name = "optim.to_range",
       .part = {},
       .result = "vec3",
       .operands = {g, floats("low", -10, 0, 1e-3), floats("high", 0, 10, 1e-3)},
       .value = "optim.to_range(v, low, high)",
       .directions = {equal(), equal("v")}},
      {.name = "optim.to_unit",
       .part = {},
       .result = "vec3",
       .operands = {g},
       .value = "optim.to_unit(v)",
       .directions = {relative("value", 8 * u, kBeforehand),
                      over("v", 16 * u, "length(g) / length(v)", "|adjoint| / |v|", kBeforehand)}},
      {.name = "optim.to_ball",
       .part = {},
       .result = "vec3",
       .operands = {vectors("v", -1e30, 1e30, 1e-30), limit},
       .value = "optim.to_ball(v, limit)",
       .directions = {relative("value", 16 * u, "like clip_length"),
                      over("v", 32 * u, "length(g) * (limit / max(length(v), limit))",
                           "|adjoint| limit / max(|v|, limit)", "like clip_length")}},
  };
}

std::vector<Function> random_functions() {
  const Operand word = {.name = "word", .type = "uint", .low = 0, .high = 4294967295.0};
  const Operand stream = {.name = "stream", .type = "uint", .low = 0, .high = 4294967295.0};
  const Operand p = {.name = "p", .type = "ivec3", .low = -2147483647.0, .high = 2147483647.0};
  const Operand n = {.name = "n", .type = "int", .low = 1, .high = 2147483647.0};
  const Operand words2 = {.name = "words", .type = "uvec2", .low = 0, .high = 4294967295.0};
  const Operand words4 = {.name = "words", .type = "uvec4", .low = 0, .high = 4294967295.0};
  std::vector<Function> all;
  const auto exact = [&](const std::string& name, const std::string& result, Operands operands,
                         const std::string& arguments) {
    all.push_back({.name = "random." + name,
                   .part = {},
                   .result = result,
                   .operands = std::move(operands),
                   .value = "random." + name + "(" + arguments + ")",
                   .directions = {equal()},
                   .domain = "all"});
    for (Operand& o : all.back().operands) o.low = std::max(o.low, -2147483647.0);
  };
  exact("pcg4d", "uvec4", {words4}, "words");
  exact("stirred", "uvec4", {words4}, "words");
  exact("bits", "uvec4", {p, stream}, "p, stream");
  exact("unit", "float", {word}, "word");
  exact("uniform", "float", {p, stream}, "p, stream");
  exact("uniform2", "vec2", {p, stream}, "p, stream");
  exact("uniform3", "vec3", {p, stream}, "p, stream");
  exact("uniform4", "vec4", {p, stream}, "p, stream");
  exact("integer", "int", {p, stream, n}, "p, stream, n");
  exact("sobol_bits", "uint", {word}, "word, 5");
  exact("sobol", "float", {word}, "word, 5");
  exact("combined", "uint", {word}, "word, random.directions(7)");
  exact("scrambled_sobol", "float", {word, stream}, "word, 3, stream");
  const std::string why = "a root, a sine and the angle's own rounding";
  const auto normal = [&](const std::string& name, const std::string& result, const std::string& scale) {
    all.push_back({.name = "random." + name,
                   .part = {},
                   .result = result,
                   .operands = {p, stream},
                   .value = "random." + name + "(p, stream)",
                   .directions = {scale.empty() ? relative("value", 8 * u, why)
                                                : over("value", 8 * u, scale, "the pair's length", why)},
                   .domain = "all"});
  };
  normal("normal", "float", "length(random.normal2(p, stream))");
  normal("normal2", "vec2", "");
  normal("normal4", "vec4", "vec4(vec2(length(y.xy)), vec2(length(y.zw)))");
  all.push_back({.name = "random.normal_pair",
                 .part = {},
                 .result = "vec2",
                 .operands = {words2},
                 .value = "random.normal_pair(words)",
                 .directions = {relative("value", 8 * u, why)},
                 .domain = "all"});
  return all;
}

std::vector<Function> elements_of_losses() {
  const Operand x = vectors("x", -1e4, 1e4, 1e-6);
  const auto apart = [](Direction d) {
    d.except = "abs(abs(mask - 128.0 / 255.0) - 0.5 / 255.0) < 1e-6";
    d.except_text = "masks as far as the limit";
    return d;
  };
  return {
      {.name = "loss.bounded",
       .part = {},
       .result = "vec3",
       .operands = {x, whole(floats("delta", 1e-3, 10), "[1]")},
       .value = "loss.bounded(x, delta)",
       .directions = all_conditioned(4 * u, 4 * u, {"x"})},
      {.name = "loss.component_mean",
       .part = {},
       .result = "float",
       .operands = {x},
       .value = "loss.component_mean(x)",
       .directions = {over("value", 4 * u, "dot(abs(x), vec3(1.0)) / 3.0", "the mean of the sizes", kFew),
                      relative("x", 2 * u, kFew)}},
      {.name = "loss.mean_square",
       .part = {},
       .result = "float",
       .operands = {x},
       .value = "loss.mean_square(x)",
       .directions = {relative("value", 4 * u, kFew), relative("x", 4 * u, kFew)}},
      {.name = "loss.known",
       .part = {},
       .result = "float",
       .operands = {floats("mask", 0, 1, 1e-3)},
       .value = "loss.known(mask)",
       .directions = {apart(equal())}},
      {.name = "loss.over",
       .part = {},
       .result = "vec3",
       .operands = {vectors("color", 0, 100, 1e-3), floats("alpha", 0, 1, 1e-6), vectors("behind", 0, 100, 1e-3)},
       .value = "loss.over(color, alpha, behind)",
       .directions = {over("value", 1e-6, "max(color, behind)", "the larger colour", kBeforehand),
                      relative("color", 2 * u, kFew), relative("behind", 2 * u, kFew),
                      over("alpha", 1e-6, "dot(abs(g), max(color, behind))", "the larger colour times |adjoint|",
                           kBeforehand)}},
      {.name = "loss.decibels",
       .part = {},
       .result = "float",
       .operands = {floats("noise", 1e-20, 1e4)},
       .value = "loss.decibels(noise)",
       .directions = all_conditioned(4 * u, 8 * u, {"noise"})},
  };
}

std::vector<Function> elements_of_textures() {
  const Operand wide = vectors("dx", -1e6, 1e6, 1e-6, "vec2"), high = vectors("dy", -1e6, 1e6, 1e-6, "vec2");
  return {
      {.name = "texture.level",
       .part = {},
       .result = "float",
       .operands = {wide, high},
       .value = "texture.level(dx, dy, 8)",
       .directions = all_conditioned(8 * u, 16 * u, {"dx", "dy"})},
      {.name = "texture.direction_to_uv",
       .part = {},
       .result = "vec2",
       .operands = {vectors("d", -1e4, 1e4, 1e-6)},
       .value = "texture.direction_to_uv(d)",
       .directions = all_conditioned(8 * u, 16 * u, {"d"})},
      {.name = "texture.uv_to_direction",
       .part = {},
       .result = "vec3",
       .operands = {vectors("uv", -2, 3, 1e-6, "vec2")},
       .value = "texture.uv_to_direction(uv)",
       .directions = {over("value", 4 * u, "1.0 + 7.0 * length(uv)", "1 + 7 |uv|", "the angle's own rounding"),
                      over("uv", 4 * u, "7.0 * length(g) * (1.0 + 7.0 * length(uv))", "7 |adjoint| (1 + 7 |uv|)",
                           "like the value")}},
      {.name = "texture.sobol_jitter",
       .part = {},
       .result = "vec2[1]",
       .operands = {},
       .value = "texture.sobol_jitter()",
       .directions = {equal()},
       .domain = "runs 1 … 2^20",
       .whole = true},
  };
}

}  // namespace

std::vector<Function> number_functions() {
  std::vector<Function> all = optimizers();
  for (auto&& part : {schedules(), clipping(), random_functions(), elements_of_losses(), elements_of_textures()})
    all.insert(all.end(), part.begin(), part.end());
  return all;
}

}  // namespace dr::accuracy::library
