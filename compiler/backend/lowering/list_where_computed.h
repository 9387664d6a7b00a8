// SPDX-License-Identifier: Apache-2.0
// Lists of a scatter's active elements, made by the pass that computes what they depend on.
#pragma once

#include "compiler/backend/schedule/schedule.h"

namespace dr::backend {

// Where one map pass over a scatter's domain computes all that decides which elements are active, that pass lists them,
// and no dispatch has to read it all again. What only the scatter reads of the pass's results, at its own element, is
// then stored for listed elements alone, and a condition that all of these fulfil not at all. Requires:
// legalize_scatter(), and no pass added or moved later. Establishes: `listed_by` and `partial` of passes.
void list_where_computed(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule);

}  // namespace dr::backend
