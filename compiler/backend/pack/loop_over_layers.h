// SPDX-License-Identifier: Apache-2.0
// Reductions of a list over its layers, as those of gradients over views are, become loops of the pass that reads what
// comes of them: one dispatch less that others wait for.
//   %s = reduce_sum %x ints [0, 0, 1]                  # x: [V, 1, N], s: [V]
//     =>
//   %s = reduce 0, N { yield gather %x, (v, 0, %k) }
// The loops stand in each other as deep as the tree of a reduction is (emit/reduce.cpp), and add in its order, so that
// no bit changes.
#pragma once

#include <optional>

#include "compiler/backend/pack/rewriter.h"
#include "compiler/target/profile.h"

namespace dr::backend {

// Nothing where there is no such reduction, or on a device that is no GPU: others run few lanes at once.
std::optional<Joined> loop_over_layers(const ir::Graph& graph, const target::Profile& profile);

}  // namespace dr::backend
