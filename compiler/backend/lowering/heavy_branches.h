// SPDX-License-Identifier: Apache-2.0
// Branches that are worth a dispatch of their own, for devices whose lanes run both branches of every `if`
// (Profile::lanes_in_turn), and for large pictures on others.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "compiler/backend/schedule/schedule.h"
#include "compiler/backend/schedule/trips.h"

namespace dr::backend {

// The `if`s of a map pass whose first branch is worth leaving out for the elements that do not take it; empty if all of
// it is not. `trips`: of the pass.
std::vector<ir::OpId> heavy_branches(const ir::Graph& graph, const Pass& pass, const Trips& trips,
                                     const target::Profile& profile);

// The `if`s of a map whose condition is unlikely, which it may leave to a third dispatch where lanes go in turn; empty
// if they are all that is `heavy`, or if it is not worth it.
std::vector<ir::OpId> unlikely_branches(const ir::Graph& graph, const Pass& pass, std::span<const ir::OpId> heavy,
                                        const target::Profile& profile);

// Whether several lanes of a GPU may have an element of such branches, and share its loops: those that combine integers
// and have loops within. Few elements, whose loops are long, then take as long as the longest part of one.
bool share_loops(const ir::Graph& graph, std::span<const ir::OpId> heavy, const target::Profile& profile);

// Where there are none: a select of the map by whose condition most of its work is for nothing where that does not
// hold, as all that shades a pixel is where it sees nothing. Where lanes go in turn; `sinks` are what the map is for.
std::optional<ir::OpId> heavy_select(const ir::Graph& graph, const Pass& pass, std::span<const ir::ValueId> sinks,
                                     const Trips& trips, const target::Profile& profile);

}  // namespace dr::backend
