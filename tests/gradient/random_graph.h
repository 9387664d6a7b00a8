// SPDX-License-Identifier: Apache-2.0
// Random smooth graphs with regions in regions, reads and writes at computed places and gradients inside. Nothing in
// them grows without bound, and nothing is singular.
#pragma once

#include <array>

#include "tests/gradient/build.h"

namespace dr::gradient_test {

struct RandomGraphOptions {
  size_t ops = 50;                           // of the smallest graphs, before differentiation and without the leaves
  int steps = 22;                            // of the generator, at least; each emits an op or a few, a region many
  std::array<int64_t, 3> sizes = {4, 3, 2};  // of images, on each axis that or 1
  int64_t long_trips = 0;                    // of one loop more; gradients are then taken of the whole alone
};

struct RandomGraph {
  Builder builder;
  std::vector<ValueId> params;  // the leaves, leaf_name(k)
  ValueId y;                    // float, made of the later values
  Images data;                  // of the leaves, between -1.5 and 1.5
  Random random;                // to go on with
};

std::string leaf_name(size_t k);
RandomGraph random_graph(uint64_t seed, const RandomGraphOptions& options = {});

}  // namespace dr::gradient_test
