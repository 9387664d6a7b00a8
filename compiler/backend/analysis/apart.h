// SPDX-License-Identifier: Apache-2.0
// How far apart two integers of an element are at most, whichever element it is.
//   %a = max(floor(x / 2), 0)    %b = min(floor((x - 1) / 2) + 1, W)    =>    %b is at most 1 above %a
#pragma once

#include <cstdint>
#include <optional>

#include "compiler/ir/graph.h"

namespace dr::backend {

// The most that `high` is above `low`, which may be less than 0; nothing where that is not known. Looks through sums,
// divisions, minima and maxima, and at both sides of selects, whose conditions it believes there.
std::optional<int64_t> most_apart(const ir::Graph& graph, ir::ValueId high, ir::ValueId low);

}  // namespace dr::backend
