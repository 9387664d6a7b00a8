// SPDX-License-Identifier: Apache-2.0
// Stage packing: orders the passes of a step and joins them into stages.
//   fragment passes over one extent that read each other at their own pixel only  =>  subpasses of one render pass
//   dispatches none of which needs another                                        =>  a run with one barrier before it
// Requires: passes in an order in which every read is written before. Establishes: the rules of stages that
// check_schedule() knows; consecutive passes of one `stage` number. Greedy: what cannot join goes first, since it may
// be all that a fragment pass waits for; then the extent with most passes to join.
#pragma once

#include "compiler/backend/schedule/schedule.h"

namespace dr::backend {

// `join` false leaves every pass a stage of its own, in the same order.
void pack_stages(const ir::Graph& graph, StepSchedule& step, const target::Profile& profile, bool join);

}  // namespace dr::backend
