// SPDX-License-Identifier: Apache-2.0
// Packing: a graph becomes the passes of a schedule, as few as the limits of the profile allow.
#pragma once

#include <map>
#include <set>
#include <string>

#include "compiler/backend/schedule/schedule.h"
#include "compiler/target/profile.h"

namespace dr::backend {

// Leaves, by step, that others change before each of its runs. What depends on them stands apart from the prologue too,
// so that the rest of it can be kept.
using Moving = std::map<std::string, std::set<std::string>>;

struct PackOptions {
  bool fused = true;             // substage packing; false: one op, one pass
  bool recompute = true;         // cheap values again where they are used, rather than stored
  bool stages = true;            // stage packing; false: each pass a stage
  bool prologue = true;          // what a step does not change apart from what it does, so that it can be kept
  bool fragment = false;         // maps over 2D extents as fragment passes that write images
  bool hardware_raster = false;  // raster by draws
  // Fragment passes that blocks of elements make cheaper are compute passes (lowering/block_loops.h).
  bool blocks = true;
  Moving moving;
};

Schedule pack(const ir::Graph& graph, const target::Profile& profile, const PackOptions& options);

}  // namespace dr::backend
