// SPDX-License-Identifier: Apache-2.0
// How many trips the loops of a shader take: the one place that accounts for them. Some drivers end all loops of an
// invocation, without a word, when they have taken so many together (target::Profile::loop_trips). Every op that is
// printed as a loop has its case in trips_of(); loops that generated code has of its own are bounded where they are
// written.
#pragma once

#include <optional>
#include <span>

#include "compiler/backend/schedule/schedule.h"
#include "compiler/ir/graph.h"
#include "compiler/target/profile.h"

namespace dr::backend {

struct Trips {
  // Of one invocation, at most: one for each time that a loop's body runs, and one for each time that a loop ends.
  ir::Dim most = 0;
  int loops = 0;     // in the text
  int unknown = 0;   // their range depends on data and nothing bounds it: `most` is without their trips
  int promised = 0;  // their range depends on data, and what bounds it is the program's `max`
  bool even = true;  // all invocations take the same trips

  Trips& operator+=(const Trips& other);
  friend Trips operator+(Trips a, const Trips& b) { return a += b; }
};

// What ops of the root region or of one region take together, whatever way their `if`s go.
Trips trips_of(const ir::Graph& graph, std::span<const ir::OpId> ops);

// What an op's regions take together, each run once: those of a raster are its closures.
Trips trips_of_regions(const ir::Graph& graph, const ir::Op& op);

// What the loops of the shader that walks a raster's faces take, beside those of the walk itself.
struct WalkTrips {
  ir::Dim pixel;         // for a pixel, by the invocation that finds the face
  ir::Dim listed;        // for one of a lane's share of a listed face
  ir::Dim face;          // to set a face up again
  bool watched = false;  // whether nothing but data, or the program's word, bounds them
};

// How a raster's pixels are kept: in words of 32 or 64 bits (Code::wide_words), or in bits.
enum class KeptPixels : uint8_t { Words, WideWords, Bits };
KeptPixels kept_pixels(const Schedule& schedule, const StepSchedule& step, const ir::Op& raster);

// Whether a walk computes the depths of pixels.
bool has_depths(const ir::Graph& graph, const ir::Op& raster, KeptPixels kept);

// What lanes that walk a listed face compute of its record: what no pass stores, from what one does. `setup`:
// FaceSetup::pass, or null. `but`: taken as not stored.
std::vector<ir::OpId> set_up_again(const ir::Graph& graph, const Pass& raster, const Pass* setup, KeptPixels kept,
                                   const std::set<ir::ValueId>& but = {});

// `in_words`: lanes share words of pixels (FaceWalk::wanted, KeptPixels::Bits).
WalkTrips walk_trips(const ir::Graph& graph, const Pass& pass, const ir::Op& op, const Pass* setup, KeptPixels kept,
                     bool in_words);

// The walk of one row's items (emit/rows.cpp), for a pass that sums by rows. A row is walked twice, by blocks that
// other invocations have summed, and item by item where it begins and ends within a block.
ir::Dim row_block(const ir::Dim& items);  // items of a block
// What an invocation takes whose row has all items, each with loops of `item` trips. Lanes come to items and to blocks
// at different times, and all wait for an item's loops.
ir::Dim row_walk(const ir::Dim& items, const ir::Dim& item, int64_t lanes);
// Whether no row may take more than the device allows. It is not asked of items of an extent that is not known before
// data is bound, where they have no loops: the runtime asks for that.
bool may_walk_rows(const ir::Graph& graph, const Pass& pass, const RowsScatter& rows, const target::Profile& profile);

// Whether so many are not known to be within what the profile lets an invocation take, which is shared by `times` runs.
bool may_pass_limit(const Trips& trips, const target::Profile& profile, int64_t times = 1);

// Whether the shader of such loops has to stop and go on later, or to tell where the device ended one: they may pass
// the limit, or nothing but data bounds them. Only a pass's own compute shader can; one that walks a raster's faces
// tells. Whatever else gives loops to another shader, or to invocations that run them `times` times, asks here first.
bool needs_cut(const Trips& trips, const target::Profile& profile, int64_t times = 1);

// What an int, or the whole part of a float, is at most and at least, for all elements and components.
struct Bounds {
  std::optional<ir::Dim> low, high;
};
Bounds bounds_of(const ir::Graph& graph, ir::ValueId value);

}  // namespace dr::backend
