// SPDX-License-Identifier: Apache-2.0
// Random programs to compare roads with: half of them compute with small whole numbers, exactly, and must agree in all
// bits; half are smooth, with gradients inside and of the whole.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "compiler/ir/graph.h"
#include "compiler/target/profile.h"
#include "runtime/runtime.h"
#include "tests/gradient/build.h"

namespace dr::test {

using gradient_test::Images;

struct Problem {
  ir::Graph graph;  // one step, "run"
  uint64_t seed = 0;
  bool exact = false;
};

// How large a program's images and loops are.
struct Sizes {
  std::array<int64_t, 3> images = {4, 3, 2};
  int64_t trips = 0;  // of one loop more, of smooth programs alone
};

// As a front end leaves it, gradients and all; even seeds compute exactly.
Problem random_problem(uint64_t seed, const Sizes& sizes = {});
// After the compiler's passes over graphs.
ir::Graph lowered(const ir::Graph& graph);
// What the leaves hold. An image's numbers depend on the seed, its name and their place, so that a program that is cut
// down has some of the numbers that it had.
Images data_of(const Problem& problem);

// What is wrong is thrown: these are as std::runtime_error.
// The outputs of a lowered graph. `moved` moves all floats by so much of themselves, up or down at random.
Images evaluate(const Problem& problem, const ir::Graph& graph, bool float32, double moved = 0);

// A way through the compiler.
struct Way {
  const char *lower = "compute", *pack = "fused";
  std::vector<std::string> ablate = {};
  const char* scatter = "auto";
  std::string str() const;
};
// What a profile or a device cannot meet, as it says, is thrown as this.
struct BeyondProfile : std::runtime_error {
  using std::runtime_error::runtime_error;
};
Images run_on(const runtime::Device& device, const Problem& problem, const ir::Graph& graph,
              const target::Profile& profile, const Images& like, const Way& way);

// The largest difference of the outputs, each in units of its largest number or of 1; infinite where one is NaN or Inf
// and the other not, or where integers or bools differ.
double distance(const Images& found, const Images& expected);

}  // namespace dr::test
