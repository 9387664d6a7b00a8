// SPDX-License-Identifier: Apache-2.0
// Updates whose elements rest where no gradient comes (AtRest): what such a pass must be.
#pragma once

#include "compiler/backend/analysis/rest.h"
#include "compiler/backend/schedule/schedule.h"

namespace dr::backend {

// What is known of values of an update at an element that has no row of the gradient and whose memory is zero.
RestFacts facts_at_rest(const ir::Graph& graph, const StepSchedule& step, const Pass& update, const AtRest& rest);

// Whether such an element, where a run would leave it as it is once, stays as it is: nothing but the update reads the
// gradient, and all that it writes are leaves, whose values are fixed. Where elements are listed, in front of the
// gradient's sums, all is there that tells whether one stays as it is.
bool may_rest(const ir::Graph& graph, const Schedule& schedule, const StepSchedule& step, PassId update,
              const AtRest& rest);

// The ops of an update that tell what it writes at rest, which is where they are not zero themselves.
std::vector<ir::OpId> ops_at_rest(const ir::Graph& graph, const Pass& update, const RestFacts& facts);

// What an update gathers of what the step computes, as a level of a pyramid hands its gradient to the one below: reads
// elsewhere, and loops with such.
std::vector<ir::OpId> stirring_gathers(const ir::Graph& graph, const StepSchedule& step, const Pass& update);
// What those give.
std::vector<ir::ValueId> gathered_at_rest(const ir::Graph& graph, const AtRest& rest);

// The update whose elements at rest a scatter by rows leaves out, too, or that reads this sum of one by exact sums;
// null: there is none.
const Pass* update_of(const StepSchedule& step, PassId gradient, std::optional<ir::ValueId> sum = {});

}  // namespace dr::backend
