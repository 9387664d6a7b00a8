// SPDX-License-Identifier: Apache-2.0
// Measuring cases of the accuracy table on a device: all values and derivatives of some cases are one bundle; the judge
// is the float64 evaluator on the same graph and the same float32 operands.
#pragma once

#include <span>

#include "runtime/runtime.h"
#include "tests/device/accuracy/cases.h"

namespace dr::accuracy {

// One function and direction on one device.
struct Row {
  std::string op, direction;  // "pow", "value" or "d/dx2"
  std::string domain = {}, scale = {}, why = {};
  int64_t samples = 0;   // elements inside the domain whose error was taken
  double bound = 0;      // in last places; where there is a promise, that says what it is
  double worst = 0;      // the largest error in last places; infinite for NaN or Inf where there must be none
  double share = 0;      // the largest error as a share of what is allowed there
  double p999 = 0;       // below which 99.9% of the errors are
  double relative = 0;   // the largest relative error of results that are normal numbers
  double near_zero = 0;  // the largest absolute error of those that are not
  int64_t special = 0;   // special values outside the domain, which must only be finite where the result is
  int64_t not_finite = 0;
  std::string worst_input = {};  // float32 bits of the operands' components, or the element of an image
  double expected = 0, found = 0;
  std::string promise = {};
  bool passes() const { return share <= 1 && not_finite == 0; }
};

struct Options {
  std::string profile;
  std::string lower = "auto";  // auto, fragment, compute
  std::string float_profile = "strict";
  int64_t random = 4096;  // random elements a case, besides special values
  uint64_t seed = 1;
};

// An operand's domain in words.
std::string range(const Operand& operand);

// Errors of the device or the compiler end the process with a message.
std::vector<Row> measure(const runtime::Device& device, std::span<const Case> cases, const Options& options);

}  // namespace dr::accuracy
