// SPDX-License-Identifier: Apache-2.0
// Reads that need no look at whether their place is within the image.
#pragma once

#include "compiler/ir/graph.h"

namespace dr::backend::glsl {

// Whether a Gather's index always names a place of its image: positions, trips of loops and what is made of them by
// arithmetic whose bounds are known. For symbols of at least 1: without elements, nothing reads.
bool is_inside(const ir::Graph& graph, const ir::Op& gather);

}  // namespace dr::backend::glsl
