// SPDX-License-Identifier: Apache-2.0
// Cuts a graph down that has a fault, as long as what is left still has it: outputs, ops, regions, results of regions,
// extents and constants go, many at a time first. Each graph on the way is sound.
#pragma once

#include <functional>

#include "compiler/ir/graph.h"

namespace dr::test {

// `fails` says whether a sound graph has the fault, as the given one does. It may take long, so that no more is tried
// after `seconds`.
ir::Graph reduce_graph(ir::Graph graph, const std::function<bool(const ir::Graph&)>& fails, double seconds);

// Ops of all regions, constants and leaves left out.
size_t ops_of(const ir::Graph& graph);

}  // namespace dr::test
