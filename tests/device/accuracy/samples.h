// SPDX-License-Identifier: Apache-2.0
// Operands for the accuracy table: random ones of a case's domain, stratified over exponents, and the special values
// T0.
#pragma once

#include <cstdint>

#include "compiler/reference/evaluate.h"
#include "tests/device/accuracy/cases.h"

namespace dr::accuracy {

// Zeros, subnormals, the ends of the normal range, 1 and its neighbours, powers of two, multiples of pi/2, thresholds
// of exp, Inf and NaN; all representable in float32.
std::vector<double> special_floats();
std::vector<double> special_integers(ir::Scalar scalar);

struct Samples {
  std::vector<reference::Image> operands;  // one an operand of the case
  std::vector<bool> inside;                // by element: whether all operands lie in the case's domain
  int64_t random = 0;                      // how many elements are random ones
};

// At least `random` random elements, then combinations of special values and the op's singular points; the images are
// kWidth wide.
Samples draw(const Case& c, int64_t random, uint64_t seed);
// Seeds of adjoints for a result of `type`: numbers around 1 of both signs, now and then 0.
reference::Image draw_weights(ir::Type type, int64_t width, int64_t height, int64_t layers, uint64_t seed);

}  // namespace dr::accuracy
