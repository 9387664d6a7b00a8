// SPDX-License-Identifier: Apache-2.0
// `if`s that differ only in what they take from around them, as what a picture does at each of a pixel's four sides.
// One text in a loop serves them all. Drivers then compile a fraction of the text, and a lane runs it as often as its
// own conditions hold, whichever they are: one text each would hold up all lanes of a subgroup if one of them takes it.
//   a = if c { f(x) } else { 0 }    b = if d { f(y) } else { 0 }
//     =>    for each of (c, x, a), (d, y, b) whose condition holds: its result = f(of it)
#pragma once

#include <span>
#include <vector>

#include "compiler/ir/graph.h"

namespace dr::backend {

// Ops that share a text, which is that of the first; or one op by itself.
struct Together {
  std::vector<ir::OpId> ops;
  // The values from outside that they do not all take alike: one for each op.
  std::vector<std::vector<ir::ValueId>> taken;
};

// The ops of a region, or some of them, in an order in which what shares a text stands together. Empty: nothing does.
std::vector<Together> alike_together(const ir::Graph& graph, std::span<const ir::OpId> ops);

}  // namespace dr::backend
