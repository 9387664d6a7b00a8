// SPDX-License-Identifier: Apache-2.0
// Exact sums of what one map computes at all elements, on devices whose lanes go in turn: the map adds it itself, by
// the exponents of the step's run before, and the second run, which has nothing to do as a rule, computes it again.
// Nothing is stored for a scatter to load, and none of its dispatches looks at each element.
//   pass p compute [512, 512]                           pass p compute [512, 512]
//     ops mul %5                                          ops mul %5
//     writes x                                            writes
//   pass grad scatter exact [512, 512]            =>    pass grad scatter exact [512, 512]
//     reads x                                             reads picture
//     ops scatter_add %7                                  ops mul %5, scatter_add %7
//     sum grad of %7                                      sum grad of %7
//                                                         joins p
//                                                         again
//                                                         guesses exponents
// All such scatters of a map become one pass. Requires: legalize_scatter().
#pragma once

#include "compiler/backend/schedule/schedule.h"
#include "compiler/target/profile.h"

namespace dr::backend {

void add_where_computed(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule);

}  // namespace dr::backend
