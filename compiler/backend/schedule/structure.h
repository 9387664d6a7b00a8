// SPDX-License-Identifier: Apache-2.0
// The first half of check_schedule().
#pragma once

#include <vector>

#include "compiler/backend/schedule/schedule.h"

namespace dr::backend {

std::vector<Violation> check_structure(const ir::Graph& graph, const Schedule& schedule);

}  // namespace dr::backend
