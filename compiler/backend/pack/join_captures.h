// SPDX-License-Identifier: Apache-2.0
// A region that uses more values than a shader may bind buffers gets them as components of fewer:
//   %r = if %c { add %a, %b .. }    =>    %j = pin(compose %a, %b) ; %r = if %c { add (extract %j 0), (extract %j 1) ..
//   }
// Up to four values of one type and extent become a vector or matrix, so a second round leaves a sixteenth. No bit of
// any result changes. Packing comes again after it, since what is stored where follows from who uses what.
#pragma once

#include <optional>

#include "compiler/backend/pack/rewriter.h"
#include "compiler/backend/schedule/schedule.h"

namespace dr::backend {

// Nothing where each pass of the schedule fits the profile, or where there is nothing left to join.
std::optional<Joined> join_captures(const ir::Graph& graph, const Schedule& schedule, const target::Profile& profile);

}  // namespace dr::backend
