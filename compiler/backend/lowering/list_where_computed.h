// SPDX-License-Identifier: Apache-2.0
// Lists of a scatter's active elements, made by the pass that computes what they depend on.
#pragma once

#include "compiler/backend/schedule/schedule.h"

namespace dr::backend {

// Where one map pass over a scatter's domain computes all that decides which elements are active, that pass lists them,
// and no dispatch has to read it all again. What only the scatter reads of the pass's results, at its own element, is
// then stored for listed elements alone, and a condition that all of these fulfil not at all. A pass may also list what
// takes its heavy branches before the adjoint is there: the list then has more elements, and on processors a dispatch
// leaves out those with an adjoint of zero. Requires: legalize_scatter(), and no pass added or moved later.
// Establishes: `listed_by`, `nonzero` and `partial` of passes. The pass also does the scatter's first run where that is
// cheap: on devices whose lanes take turns, if elements add only in a heavy branch (heavy_branches.h), and `branches`,
// which says that these have a dispatch of their own.
void list_where_computed(const ir::Graph& graph, const target::Profile& profile, bool branches, Schedule& schedule);

}  // namespace dr::backend
