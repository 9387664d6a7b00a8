// SPDX-License-Identifier: Apache-2.0
// Elements of params that no gradient reaches and that an optimizer has nothing to do for, as texels are that no pixel
// reads: neither are their gradients summed, nor are they stepped.
#pragma once

#include "compiler/backend/schedule/schedule.h"

namespace dr::backend {

// Sets `rest` of the updates that take their gradient from sorted rows, or from sums by atomics, and whose elements
// rest for good (schedule/rest.h). The other elements are listed in the prologue, or, on GPUs and where an update
// gathers what may move it, their blocks are marked; where lanes are in turn, those of a list have a bit each. Sums
// list or mark what they add to for the first time, and the update leaves them empty. Float atomics do on GPUs, and for
// lists.
void leave_at_rest(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule);

}  // namespace dr::backend
