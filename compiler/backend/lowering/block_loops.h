// SPDX-License-Identifier: Apache-2.0
// Loops in which neighbours read the same: matrix products, dense layers, convolutions, the nearest of many points.
// An invocation computes a block of elements and reads once what they share; on GPUs the invocations of a workgroup
// read together, into shared memory, what all of them need for some trips of the loop.
//   pass c compute [W, H]                    pass c compute [W, H]
//     reads a b                       =>       reads a b
//     ops .., reduce %15                       ops .., reduce %15
//     writes c                                 writes c
//                                              block 4 4 1
//                                              read together gather %9, gather %11 by 16 16 1 for 16 of reduce %15
// Each element's own sums see their terms in the same order: the bits stay.
#pragma once

#include "compiler/backend/schedule/schedule.h"

namespace dr::backend {

// Fills MapPass::block where the profile's costs say that it pays.
void block_loops(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule);

}  // namespace dr::backend
