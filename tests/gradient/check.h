// SPDX-License-Identifier: Apache-2.0
// Checks the gradients and second derivatives of a small graph against central differences.
#pragma once

#include "tests/gradient/build.h"

namespace dr::gradient_test {

// A graph under construction with the data of its leaves. Float leaves made by `param` are what is differentiated.
struct Problem {
  explicit Problem(uint64_t seed = 1) : random(seed) {}

  // A leaf with random data of [low, high).
  ValueId param(const std::string& name, Type type, const Extent& extent, double low = -1, double high = 1);
  // A leaf with given data, not differentiated.
  ValueId input(const std::string& name, Type type, const Extent& extent, std::vector<double> data);

  Builder b;
  Images data;
  std::vector<ValueId> params;
  Random random;
};

struct CheckOptions {
  double tolerance = 1e-8;  // relative to the largest number in the gradient, or to 1
  bool second = true;
};

// Compares the gradient of <w, y>, for a random w, with central differences in each component of each param. Then the
// same for the gradient's own inner product with random directions, differentiated in the params and in w: every
// second derivative takes part, mixed ones too. Sound graphs are checked after every step.
void check_gradients(Problem problem, ValueId y, const CheckOptions& options = {});

// Differentiates, with the result verified.
Graph differentiated(const Graph& graph);

}  // namespace dr::gradient_test
