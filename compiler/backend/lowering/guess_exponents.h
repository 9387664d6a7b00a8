// SPDX-License-Identifier: Apache-2.0
// Exact sums need an exponent that fits the largest contribution, which a first run finds before a second one adds.
// From run to run of a step it seldom changes: the first run adds by the exponent of the step's run before, and the
// second has nothing to do, unless the exponent is another one now. Then it adds to each sum what the right exponent
// would have added less what the guess did; integers wrap around, so that what the guess added cancels to the bit.
//   pass grad scatter exact [2048, 2048]              pass grad scatter exact [2048, 2048]
//     sum grad of %7                            =>      sum grad of %7
//     joins p                                           joins p
//     keeps terms                                       guesses exponents
// Only on GPUs, or where a map adds and lanes take turns (list_where_computed.h), and where the sums are no larger than
// their caches. Both runs must compute the same contributions: with the driver's own floats they need not.
#pragma once

#include "compiler/backend/schedule/schedule.h"
#include "compiler/target/profile.h"

namespace dr::backend {

// Whether an invocation asks between both runs of a scatter whether guesses were right: where lanes go in turn, those
// of a second run that has nothing to do still go once through all of its shader.
bool asks_for_guesses(const target::Profile& profile);

// Whether the shaders that bind a guess of the step may bind it beside sums and lists.
bool guesses_have_room(const target::Profile& profile, const Schedule& schedule, const StepSchedule& step);

void guess_exponents(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule);

}  // namespace dr::backend
