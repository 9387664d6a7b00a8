// SPDX-License-Identifier: Apache-2.0
// The part of an image that a read in a loop needs, for a box of elements and some trips of the loop: a box itself,
// where each component of the index is a sum of positions, trips and what is the same for all of them.
//   b.at(ivec2(p.x, k))              64 elements along x, 16 trips of k: 64 x 16 elements of b
//   x.at(ivec2(p.x + u, p.y + v))    16 x 16 elements, 9 trips of v with 9 of u each: 24 x 24 elements of x
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "compiler/backend/analysis/axes.h"
#include "compiler/ir/graph.h"

namespace dr::backend {

struct ReadPart {
  // A position on an axis of the elements, or a trip's number, times what: positive.
  struct Term {
    int axis = -1;
    ir::ValueId trip;
    int64_t times = 1;
    int64_t first = 0;  // of an inner loop: its first trip
  };
  struct Component {
    std::vector<Term> terms;
    std::vector<std::pair<ir::ValueId, int64_t>> others;  // values that are the same for all, times what
    int64_t constant = 0;
    int64_t extent = 1;  // of the part on this axis of the image
  };
  std::array<Component, 3> at;

  int64_t elements() const { return at[0].extent * at[1].extent * at[2].extent; }
};

// Of a gather in a Reduce, or in one inside it whose bounds are numbers. `box`: elements along the axes; `trips`: of
// the loop. Nothing where the part is no such box.
std::optional<ReadPart> read_part(const ir::Graph& graph, const ir::Op& gather, ir::OpId loop,
                                  const std::array<int, 3>& box, int trips, ChangingAxes& changing);

// All gathers in the regions of an op.
std::vector<ir::OpId> gathers_in(const ir::Graph& graph, const ir::Op& op);

// How many trips a loop takes where its bounds are numbers.
struct FixedTrips {
  int64_t first = 0, count = 0;
};
std::optional<FixedTrips> fixed_trips(const ir::Graph& graph, const ir::Op& loop);

}  // namespace dr::backend
