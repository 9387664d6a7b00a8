// SPDX-License-Identifier: Apache-2.0
// Makes one scatter of several of one domain:  sum a of %7  +  sum b of %9  =>  sum a of %7, sum b of %9
#pragma once

#include <set>

#include "compiler/backend/schedule/schedule.h"

namespace dr::backend {

// A scatter that does what those of a group do, by their places in a step. All else it has of the first of them.
Pass united(const ir::Graph& graph, const StepSchedule& step, const std::set<size_t>& group);

// Puts a pass in the place of the first of a group, and leaves the others empty.
void put_in_place_of(const std::set<size_t>& group, Pass pass, StepSchedule& step);

}  // namespace dr::backend
