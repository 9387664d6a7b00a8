// SPDX-License-Identifier: Apache-2.0
// Loops whose trips know nothing of each other: they only scatter, or give integers whose sum has no order. Several
// invocations may share the trips of one.
#pragma once

#include <span>

#include "compiler/ir/graph.h"

namespace dr::backend {

// Whether a Reduce, or a Fold's last sweep, does nothing but scatter in each trip. A Fold may count its trips before,
// and hand states on as they are.
bool only_scatters(const ir::Graph& graph, const ir::Op& op);

// Whether there is such a loop among these ops or in their branches and loops.
bool have_loop_that_only_scatters(const ir::Graph& graph, std::span<const ir::OpId> ops);

// Whether a Reduce gives nothing but sums, or least or greatest ones, of integers.
bool combines_in_any_order(const ir::Graph& graph, const ir::Op& op);

// Whether there is such a loop with loops within among these ops or in their branches.
bool have_long_loop_in_any_order(const ir::Graph& graph, std::span<const ir::OpId> ops);

}  // namespace dr::backend
