// SPDX-License-Identifier: Apache-2.0
// Short forms that the table of library functions is written with.
#pragma once

#include "tests/device/accuracy/library.h"

namespace dr::accuracy::library {

using Operands = std::vector<Operand>;
using Directions = std::vector<Direction>;

inline Operand floats(std::string name, double low, double high, double least = 0) {
  return {.name = std::move(name), .type = "float", .low = low, .high = high, .least = least};
}
inline Operand vectors(std::string name, double low, double high, double least = 0, std::string type = "vec3") {
  return {.name = std::move(name), .type = std::move(type), .low = low, .high = high, .least = least};
}
inline Operand whole(Operand o, std::string extent) {
  o.extent = std::move(extent);
  return o;
}
inline Operand made(std::string name, std::string type, std::string from, std::string extent = {}) {
  return {.name = std::move(name), .type = std::move(type), .from = std::move(from), .extent = std::move(extent)};
}
inline Operands join(std::initializer_list<Operands> parts) {
  Operands all;
  for (const Operands& part : parts) all.insert(all.end(), part.begin(), part.end());
  return all;
}
// A direction of length 1, as near as float32 comes to it.
inline Operands unit(const std::string& name) {
  Operand direction = made(name, "vec3", "normalize(" + name + "_)");
  direction.direction = true;
  return {vectors(name + "_", -1, 1, 1e-3), direction};
}

inline constexpr const char* kBeforehand = "the bound set beforehand";
inline constexpr const char* kFew = "a few roundings";

inline Direction relative(std::string of, double bound, std::string why) {
  return {.of = std::move(of), .bound = bound, .why = std::move(why)};
}
inline Direction over(std::string of, double bound, std::string scale, std::string text, std::string why) {
  return {.of = std::move(of),
          .bound = bound,
          .metric = Metric::Scaled,
          .scale = std::move(scale),
          .scale_text = std::move(text),
          .why = std::move(why)};
}
inline Direction conditioned(std::string of, double bound, std::string why = kFew) {
  return {.of = std::move(of), .bound = bound, .metric = Metric::Conditioned, .why = std::move(why)};
}
// With a scale of its own where drivers' built-ins stand for our functions.
inline Direction by_built_ins(Direction d, std::string scale, std::string text) {
  d.native_scale = std::move(scale);
  d.native_scale_text = std::move(text);
  return d;
}
inline Direction l2(std::string of, double bound, std::string why) {
  return {.of = std::move(of), .bound = bound, .metric = Metric::L2, .why = std::move(why)};
}
inline Direction equal(std::string of = "value") {
  return {.of = std::move(of), .bound = 0, .metric = Metric::Equal, .why = "nothing is rounded"};
}
// The value and the gradients to some operands, all conditioned.
inline Directions all_conditioned(double value, double gradient, std::initializer_list<const char*> operands,
                                  const std::string& why = kFew) {
  Directions all = {conditioned("value", value, why)};
  for (const char* o : operands) all.push_back(conditioned(o, gradient, why));
  return all;
}

}  // namespace dr::accuracy::library
