// SPDX-License-Identifier: Apache-2.0
// Exact sums that a scatter reads at listed elements alone, cleared there by the map that lists them, and not as a
// whole: few pixels lie at outlines.
//   sums buffer covered : float[W, H]          =>      listed sums buffer covered : float[W, H]
// The map lists before anything is added, and all of them run in every run. What else is added is never read.
// Only on processors: a GPU fills memory faster than lanes store here and there.
#pragma once

#include "compiler/backend/schedule/schedule.h"
#include "compiler/target/profile.h"

namespace dr::backend {

void clear_where_listed(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule);

}  // namespace dr::backend
