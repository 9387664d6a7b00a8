// SPDX-License-Identifier: Apache-2.0
// Scatters that add to no place twice: each element and trip of a loop names a place of its own, as a `scan` does, and
// the reverse of a loop that reads one item a trip. They need no sum: what is there is stored, to the bit.
#pragma once

#include <span>

#include "compiler/ir/graph.h"

namespace dr::backend {

// Whether no two contributions to a scatter's result name one place. A property of the graph alone, so that all roads
// agree on it.
bool named_once(const ir::Graph& graph, ir::ValueId result);

// The same of a sum of several results.
inline bool named_once(const ir::Graph& graph, std::span<const ir::ValueId> terms) {
  return terms.size() == 1 && named_once(graph, terms[0]);
}

}  // namespace dr::backend
