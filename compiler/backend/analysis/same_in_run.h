// SPDX-License-Identifier: Apache-2.0
// What elements have in common that an invocation computes one after the other.
#pragma once

#include <optional>
#include <set>
#include <span>
#include <vector>

#include "compiler/ir/graph.h"

namespace dr::backend {

// Reads at other places that are the same for all elements of a run, and what they need, of a map's ops and in order:
// of a word of bits that the pixels of a run share, or of a camera for each layer. A run is of `run` elements, a power
// of two, that follow each other in a row `width` wide; where rows are not of whole runs there are none. `but`: values
// that are no part of it, nor is what is made of them.
std::vector<ir::OpId> reads_of_runs(const ir::Graph& graph, std::span<const ir::OpId> ops, const ir::Dim& width,
                                    int run, const std::set<ir::ValueId>& but = {});

// Reads of a stored value beside an element, at its place in a row less one or more one, held to the row: what the
// element before reads at its own place, or the next one. Either may be missing.
struct ReadsBeside {
  ir::ValueId value;
  std::optional<ir::OpId> before, after;
};

// Those of a map's ops, of values as large as its domain, in runs as above.
std::vector<ReadsBeside> reads_beside(const ir::Graph& graph, std::span<const ir::OpId> ops, const ir::Extent& domain,
                                      int run);

struct RunReads {
  std::vector<ir::OpId> same;
  std::vector<ReadsBeside> beside;
  // Ops that need not be computed for each element.
  std::vector<ir::OpId> ops() const;
};

}  // namespace dr::backend
