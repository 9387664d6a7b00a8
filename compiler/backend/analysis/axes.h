// SPDX-License-Identifier: Apache-2.0
// Which axes of its elements a value changes along. Neighbours along another axis have the same value, so that one who
// computes several of them computes it once:
//   w.at(ivec2(p.x, i)) * x.at(ivec2(i, p.y))   the first read changes along x, the second along y, the product along
//                                               both, and i along none
#pragma once

#include <cstdint>
#include <vector>

#include "compiler/ir/graph.h"

namespace dr::backend {

// Bit a: axis a, of x, y and layers.
using Axes = uint8_t;

// The axes on which an extent is not the number 1.
Axes axes_of(const ir::Extent& extent);

class ChangingAxes {
 public:
  explicit ChangingAxes(const ir::Graph& graph);

  // Of a value of any region. Where that is not known, all axes.
  Axes of(ir::ValueId value);
  // Of all results of an op, and what decides about them.
  Axes of(const ir::Op& op);

 private:
  void look(ir::RegionId region);
  Axes find(ir::ValueId value);
  Axes of_regions(const ir::Op& op);

  const ir::Graph* graph_;
  std::vector<uint8_t> known_;  // 0: not yet, or one more than the axes
};

// Whether a loop takes the same trips along all these axes and combines what it finds by sums, minima or maxima: then
// one loop can do so for several elements at once.
bool shares_trips(const ir::Op& op, Axes axes, ChangingAxes& changing);

}  // namespace dr::backend
