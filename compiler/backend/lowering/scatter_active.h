// SPDX-License-Identifier: Apache-2.0
// Which elements of a scatter pass add nothing, told by values that they read: an adjoint that is zero makes all that
// is scattered of it zero, and a condition that is false leaves the branch out that scatters.
#pragma once

#include <optional>
#include <set>
#include <vector>

#include "compiler/backend/schedule/schedule.h"

namespace dr::backend {

// A clause for each result: an element adds nothing to it unless all values of the clause are true or not zero.
// Empty if that cannot be told from the pass's reads, or if elements store something of their own.
Clauses active_elements(const ir::Graph& graph, const Pass& pass);

// The map of the step that computes every value of the clauses of a scatter pass, the last that one of them waits for.
std::optional<PassId> find_lister(const ir::Graph& graph, const StepSchedule& step, size_t scatter,
                                  const Clauses& clauses);

// Values that a pass reads at other places.
std::set<ir::ValueId> read_elsewhere(const ir::Graph& graph, const Pass& pass);

// Whether all that a scatter reads at an element is there when a map before it has computed that element: passes
// between them write none of it, and nothing that the map writes is read at other places.
bool is_computed_by_then(const ir::Graph& graph, const StepSchedule& step, PassId map, const Pass& scatter);

}  // namespace dr::backend
