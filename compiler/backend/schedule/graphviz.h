// SPDX-License-Identifier: Apache-2.0
// The schedule as a drawing: `drc build --emit=graphviz | dot -Tsvg`.
#pragma once

#include <string>

#include "compiler/backend/schedule/schedule.h"

namespace dr::backend {

// Stages are clusters, substages boxes with their ops, leaves and outputs rounded; arrows carry the resources that pass
// between them.
std::string print_graphviz(const ir::Graph& graph, const Schedule& schedule);

}  // namespace dr::backend
