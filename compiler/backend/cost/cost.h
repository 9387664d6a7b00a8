// SPDX-License-Identifier: Apache-2.0
// What things cost on a device, as its profile says: packing compares these, reports print them.
#pragma once

#include <optional>

#include "compiler/backend/schedule/schedule.h"

namespace dr::backend {

// Additions and multiplications that one element of an op takes, roughly; 0 for what only moves values.
int op_cost(ir::OpKind kind);

// What an op comes to in a shader's text, regions and all, in op_cost() units and a move a component.
size_t op_size(const ir::Graph& graph, const ir::Op& op);

// Arithmetic that costs no more than to store a component and to load it again, in op_cost() units.
int recompute_limit(const target::Profile& profile, bool fragment);

// Expected time of one run of a step in ns: each pass's fixed cost, the bytes it reads and writes, its arithmetic.
// Every value that a pass reads counts once, wherever it reads it; regions count as often as they run, loops over
// unknown ranges eight times; what the elements of a block share counts once for all of them; faces of a raster cover
// `faces_cover` pixels each. Nullopt when a symbol has no value.
struct CostAssumptions {
  double faces_cover = 64;
};
std::optional<double> step_cost(const ir::Graph& graph, const Schedule& schedule, const StepSchedule& step,
                                const target::Profile& profile, const ir::SymbolValues& symbols,
                                const CostAssumptions& assumptions = {});

}  // namespace dr::backend
