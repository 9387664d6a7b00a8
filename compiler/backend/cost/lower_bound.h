// SPDX-License-Identifier: Apache-2.0
// What no schedule of a step can do without: what packing is held against in reports.
#pragma once

#include <cstdint>
#include <optional>

#include "compiler/ir/graph.h"

namespace dr::backend {

struct LowerBound {
  // The longest chain of rasters, reductions, scatters and reads at other places, each of which waits for the last. A
  // reduction may compute what it folds.
  size_t stages = 0;
  // Each leaf that is used read once; each result, and each value that one of those ops makes or reads, written and
  // where it is used read once.
  int64_t bytes = 0;
};

// `steady`: of what the step changes, given its prologue. Nullopt where a symbol has no value.
std::optional<LowerBound> lower_bound(const ir::Graph& graph, const ir::Step& step, const ir::SymbolValues& symbols,
                                      bool steady);

}  // namespace dr::backend
