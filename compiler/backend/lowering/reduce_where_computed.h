// SPDX-License-Identifier: Apache-2.0
// Reductions of lists that compute what they fold, where nothing else needs it: one dispatch less that others wait for.
//   pass length compute [V]                         pass far reduce [V]
//     ops length %2                                   reads position
//     writes length                         =>        ops length %2, reduce_max %3
//   pass far reduce [V]                               writes far
//     reads length
//     ops reduce_max %3
//     writes far
// Of lists alone: a picture's reduction has few invocations, of many pixels each, which would take long to compute.
#pragma once

#include "compiler/backend/schedule/schedule.h"
#include "compiler/target/profile.h"

namespace dr::backend {

// Requires: packed, and no pass refers to another.
void reduce_where_computed(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule);

}  // namespace dr::backend
