// SPDX-License-Identifier: Apache-2.0
// The accuracy table: for every op what its operands are drawn from, and how far a device's value and derivatives may
// be off. Errors are counted in last places of the larger of the exact result and a *scale*: nothing for functions with
// full relative accuracy, the sum of the terms' sizes for sums, 1 for sin and cos, whose zeros are not representable.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "compiler/ir/graph.h"

namespace dr::accuracy {

// Where an operand comes from. Floats: half of the samples have a uniform exponent, half are uniform between -8 and 8,
// both within [low, high] (and magnitudes from `least` on). Others: every width alike, within [low, high].
struct Operand {
  ir::Type type;
  double low = 0, high = 0;
  double least = 0;
};

using Values = std::vector<ir::ValueId>;
// From the operands and the adjoint of the result, which is invalid where the value is asked for.
using Scale = std::function<ir::ValueId(ir::Builder&, const Values&, ir::ValueId)>;

// Bool of the operands, true where only NaN and Inf are looked for.
using Exception = std::function<ir::ValueId(ir::Builder&, const Values&)>;

// What the float profile `native` is held to where a built-in stands for our own function, instead of the bound: the
// last places that each element may be off by, Inf where nothing is promised.
struct Promise {
  Scale bound;
  std::string text, why;
  Scale scale = {};  // instead of the case's, if there is one
  std::string scale_text = {};
};

struct Derivative {
  size_t operand = 0;
  double bound = 0;
  std::string why = {};
  Scale scale = {};
  std::string scale_text = {};
  Exception except = {};
  std::optional<Promise> native = {};
};

struct Case {
  ir::OpKind kind;
  std::string name;         // "pow", "add int"
  std::string domain = {};  // in words, beyond the operands' ranges; may be empty
  std::vector<Operand> operands;
  std::function<ir::ValueId(ir::Builder&, const Values&)> build;
  double bound = 0;
  std::string why = {};
  Scale scale = {};
  std::string scale_text = {};
  std::vector<Derivative> derivatives = {};
  // Elements of the result depend on many of the operands': these all lie in the domain.
  bool mixes = false;
  Exception except = {};  // for the value; each derivative has its own
  std::optional<Promise> native = {};
};

// A case or derivative in the float profile `native`, which may have a measure and a bound of its own.
template <class T>
T in_profile(T entry, bool native) {
  if (!native || !entry.native) return entry;
  entry.bound = 1;  // not 0: that of each element is computed
  entry.why = entry.native->why;
  if (entry.native->scale) entry.scale = entry.native->scale, entry.scale_text = entry.native->scale_text;
  return entry;
}

// Every op that devices run; the rest is in `elsewhere`.
std::vector<Case> cases();
// Kinds that are gone before a device sees the graph, or whose results are discrete decisions of their own measure.
struct Elsewhere {
  ir::OpKind kind;
  std::string where;
};
std::vector<Elsewhere> elsewhere();

// Operands are images of this width.
inline constexpr int64_t kWidth = 256;

// The parts of cases(), a file each.
std::vector<Case> number_cases();        // floats, component by component
void promise_native(Case& number_case);  // what is promised of its built-in (cases_native.cpp)
std::vector<Case> word_cases();          // integers, bits, bools, conversions
std::vector<Case> image_cases();         // vectors, images, regions, sources

}  // namespace dr::accuracy
