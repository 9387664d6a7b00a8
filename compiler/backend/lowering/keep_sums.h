// SPDX-License-Identifier: Apache-2.0
// Exact sums that stay the fixed point numbers they were added as: where one pass alone reads them, each at its own
// element, it makes floats of them itself, and no dispatch of its own has to.
#pragma once

#include "compiler/backend/schedule/schedule.h"

namespace dr::backend {

// Sets Resource::sums; not of outputs, updates and pinned values, which need memory of their own.
void keep_sums(const ir::Graph& graph, Schedule& schedule);

}  // namespace dr::backend
