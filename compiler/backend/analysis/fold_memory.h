// SPDX-License-Identifier: Apache-2.0
// How a Fold's later sweeps come by the states of the earlier ones, and what that takes.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "compiler/backend/analysis/source_lines.h"
#include "compiler/ir/graph.h"

namespace dr::backend {

struct FoldMemory {
  enum class How : uint8_t {
    Nothing,      // one sweep
    All,          // the states before every trip
    Checkpoints,  // those before some; the others are computed again
  };
  How how = How::Nothing;
  int64_t slots = 0;  // that each state's array has
};

FoldMemory fold_memory(const ir::Graph& graph, const ir::Op& op);

// How many trips of the first sweep are run once more, at most, if it takes at most so many.
ir::Dim trips_again(const FoldMemory& memory, const ir::Dim& trips);

// What is wrong with the loops of a graph, one sentence a line: where all states have to be stored they must have room.
std::optional<std::string> folds_over_limit(const ir::Graph& graph, const SourceLines& lines);

}  // namespace dr::backend
