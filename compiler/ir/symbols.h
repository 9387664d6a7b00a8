// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "compiler/ir/graph.h"

namespace dr::ir {

// The symbols of a graph's extents, sorted.
std::vector<std::string> symbols_of(const Graph& graph);

}  // namespace dr::ir
