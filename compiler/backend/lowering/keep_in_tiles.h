// SPDX-License-Identifier: Apache-2.0
// Values that never leave their render pass.
#pragma once

#include "compiler/backend/schedule/schedule.h"

namespace dr::backend {

// Lets a value live only while its stage runs, where a fragment pass writes it and nothing but later passes of that
// stage reads it. Outputs, updates and pinned values are read when the step has run.
void keep_in_tiles(const ir::Graph& graph, Schedule& schedule);

}  // namespace dr::backend
