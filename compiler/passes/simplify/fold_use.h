// SPDX-License-Identifier: Apache-2.0
// Which states, results and yields of a Fold are needed, given which results are, and which states whatever becomes of
// them: a state may be needed by another one only, by what ends the loop, or by a later sweep.
#pragma once

#include <functional>
#include <vector>

#include "compiler/ir/graph.h"

namespace dr::passes {

struct FoldUse {
  std::vector<std::vector<bool>> states;         // by sweep
  std::vector<bool> results;                     // with those of the states that the last sweep keeps
  std::vector<std::vector<ir::ValueId>> yields;  // by sweep: those that stay, in order
  std::vector<std::vector<size_t>> groups;       // sweeps that are left; those of a group are one
  bool drops(const ir::Op& op) const;            // whether something is not needed
};

// `is_needed` is asked of results, and of the parameters by which a sweep's own region has its states.
FoldUse fold_use(const ir::Graph& graph, const ir::Op& op, const std::function<bool(ir::ValueId)>& is_needed);

}  // namespace dr::passes
