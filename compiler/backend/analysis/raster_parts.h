// SPDX-License-Identifier: Apache-2.0
// The operands and dimensions of a Raster op by their part.
#pragma once

#include <cstddef>
#include <optional>
#include <set>
#include <vector>

#include "compiler/ir/graph.h"

namespace dr::backend {

// The op's regions.
enum RasterRegion : size_t { kDepth, kKeep, kTag };

struct RasterParts {
  size_t count;  // K
  size_t each;   // results of a rank
  bool listed;   // one result holds the faces of all ranks
  std::vector<ir::ValueId> fields, corners;
  ir::ValueId cull;
  ir::Dim w, h, l, faces;
  ir::Extent extent() const { return {w, h, l}; }
};

RasterParts raster_parts(const ir::Op& op);

// Whether a closure is made of a field.
bool uses_field(const ir::Graph& graph, const ir::Op& op, RasterRegion closure, size_t field);

// What a walk takes of a face's record: corners, and what closures are made of, that of depths if it computes `depths`.
std::set<ir::ValueId> walked_record(const ir::Graph& graph, const ir::Op& op, bool depths);

// Whether a raster of one rank is only asked if a pixel sees a face, not which one: what reads its faces, at their own
// element or elsewhere, tells -1 from the others and no more.
bool is_asked_for_presence(const ir::Graph& graph, const ir::Op& op);

// The words of bits that say so: see bundle::kBitsOfWord.
ir::Extent bits_extent(const ir::Extent& pixels);
// Whether a value is these bits of `face`, as std.tiles.rows sums them up:
//   reduce(sum, x in 0..min(32, W - 32 * p.x)) {
//     if face.at(ivec2(32 * p.x + x, p.y)) >= 0 { 1u << uint(x) } else { 0u }
//   }
bool is_rows_of(const ir::Graph& graph, ir::ValueId value, ir::ValueId face);

// Bits of pixels, of `bits_extent`, without which no face is kept there: `keep` begins with
//   if tiles.bit(bits, ivec2(p)) { ... } else { false }
struct WantedPixels {
  ir::ValueId bits;
  ir::ValueId is_set;  // in `keep`
};
std::optional<WantedPixels> wanted_pixels(const ir::Graph& graph, const ir::Op& op);

// Whether each candidate surely has a depth, as what is clamped has: NaN loses against a bound. Else a candidate
// without one is rejected.
bool has_depth_always(const ir::Graph& graph, const ir::Op& op);

}  // namespace dr::backend
