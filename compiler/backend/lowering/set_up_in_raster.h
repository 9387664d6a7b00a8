// SPDX-License-Identifier: Apache-2.0
// The pass that computes what a compute raster reads of its faces and the raster's first dispatch both give each face
// an invocation: one shader can do both, which has the numbers at hand. What only the raster reads is computed again by
// those who walk the listed faces, from what is stored of all or from the start; where that takes more loads, it is
// stored, for those faces and for no others.
#pragma once

#include "compiler/backend/schedule/schedule.h"

namespace dr::backend {

// Fills RasterPass::setup where a raster by 64-bit atomics reads the results of a map pass over its faces and layers,
// no pass between the two needs any of them or changes what it reads, nor another raster on a GPU, both run whenever
// one of them does, and the profile's limits allow one shader for both; and MapPass::partial of the map, which is
// stored for listed faces.
void set_up_in_raster(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule);

}  // namespace dr::backend
