// SPDX-License-Identifier: Apache-2.0
// The second run of exact sums that a map adds by guesses has nothing to do, as a rule. It computes what the map does
// again, where all pixels of a picture add, or those of a branch that has a dispatch of its own (heavy_branches.h):
// then the map need neither list them nor store what they add.
//   pass p compute [2048, 2048]                         pass p compute [2048, 2048]
//     ops gather %5                                       ops gather %5
//     writes x                                            writes
//     partial x                                   =>    pass grad scatter exact [2048, 2048]
//   pass grad scatter exact [2048, 2048]                  reads picture
//     reads x                                             ops gather %5, scatter_add %7
//     ops scatter_add %7                                  sum grad of %7
//     sum grad of %7                                      joins p
//     joins p                                             again
//     guesses exponents                                   guesses exponents
// Memory that the map reads must be as it was, and its loops must be short.
#pragma once

#include <set>

#include "compiler/backend/schedule/schedule.h"
#include "compiler/target/profile.h"

namespace dr::backend {

// Makes the second run of a scatter that joins a map do so, if it may, and gives whether it did. `unused` gets the
// resources of what the map no longer stores, which remove_resources() takes out.
bool compute_again(const ir::Graph& graph, const target::Profile& profile, const Schedule& schedule, StepSchedule& step,
                   Pass& scatter, std::set<uint32_t>& unused);

void recompute_second_run(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule);

}  // namespace dr::backend
