// SPDX-License-Identifier: Apache-2.0
// What must hold for every sound graph, whoever made it.
#pragma once

#include "compiler/ir/graph.h"

namespace dr::fuzz {

// Larger inputs and graphs are left alone: what is wrong with them is wrong with small ones, which take less time.
inline constexpr size_t kMaxInput = 1 << 16;
inline constexpr size_t kMaxOps = 2000;

// Runs all passes; what each gives has to be sound, and to print and parse to itself. Aborts where it is not.
void check_passes(const ir::Graph& graph);

}  // namespace dr::fuzz
