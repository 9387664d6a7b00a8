// SPDX-License-Identifier: Apache-2.0
// Updates that are written straight into their leaf's memory.
#pragma once

#include "compiler/backend/schedule/schedule.h"

namespace dr::backend {

// Lets a pass write an update's value into the leaf itself, where nothing of the step needs the old value any more: the
// pass runs over the leaf's extent and reads the leaf at its own element only, no later pass reads it, and neither the
// old value nor the new one is an output or another leaf's update. The value's own resource goes away. All other
// updates are copied when the step ends.
void update_in_place(const ir::Graph& graph, Schedule& schedule);

}  // namespace dr::backend
