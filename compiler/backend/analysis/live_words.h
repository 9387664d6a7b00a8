// SPDX-License-Identifier: Apache-2.0
// How much a shader has to remember at a time, which is what its registers hold.
//   %a = read    %b = read    %c = add %a, %b    yield %c    =>    2: %a and %b
#pragma once

#include <span>

#include "compiler/ir/graph.h"

namespace dr::backend {

// The most words of values that are known and still wanted at one place of `ops`, which run in this order for each
// element, regions included. `until_end` are wanted behind the last one. What is the same for all elements counts
// nothing, nor do bools.
int live_words(const ir::Graph& graph, std::span<const ir::OpId> ops, std::span<const ir::ValueId> until_end);

}  // namespace dr::backend
