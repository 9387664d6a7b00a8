// SPDX-License-Identifier: Apache-2.0
// Random sound graphs with all that `simplify` looks for: constants that ops do nothing with, equal ops, dead ones, If
// with a constant condition, scatters through regions in regions. Numbers are small and few, so that float64 computes
// with them exactly: whoever changes a result changes it visibly.
#pragma once

#include <array>
#include <cstdint>

#include "compiler/ir/graph.h"

namespace dr::passes_test {

// The leaves are float "f0".."f2", int "i0".."i1", bool "b0", vec3 "v0", of constant extents, on each axis its size or
// 1; the step is "run".
ir::Graph random_graph(uint64_t seed, const std::array<int64_t, 3>& sizes = {4, 3, 2});

}  // namespace dr::passes_test
