// SPDX-License-Identifier: Apache-2.0
// Elements of params that no gradient reaches and that an optimizer has nothing to do for, as texels are that no pixel
// reads: neither are their gradients summed, nor are they stepped.
#pragma once

#include "compiler/backend/schedule/schedule.h"

namespace dr::backend {

// Sets `rest` of the updates that take their gradient from sorted rows, or, where lanes go in turn, from exact sums,
// and whose elements rest for good (schedule/rest.h). The other elements are listed in the prologue; exact sums list
// those that they add to for the first time, and the update leaves them empty.
void leave_at_rest(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule);

}  // namespace dr::backend
