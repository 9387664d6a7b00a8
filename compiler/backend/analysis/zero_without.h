// SPDX-License-Identifier: Apache-2.0
// What an element does not get where it takes none of some branches.
//   %g = if %seen { %x } else { 0 }    %h = smul %g, %y    =>    without the branch, %h is zero
#pragma once

#include <span>
#include <vector>

#include "compiler/ir/graph.h"

namespace dr::backend {

// Whether a value is zero at each element for which the conditions of all these `if`s and selects are false.
bool is_zero_without(const ir::Graph& graph, ir::ValueId value, std::span<const ir::OpId> branches);

// Those of `ops`, in order, whose results all are float zeros there, of either sign, which nothing shows: neither is
// one of the values in `shown` made of them, nor does an op divide by them, say, or look at their bits.
std::vector<ir::OpId> zeros_without(const ir::Graph& graph, std::span<const ir::OpId> ops,
                                    std::span<const ir::OpId> branches, std::span<const ir::ValueId> shown);

}  // namespace dr::backend
