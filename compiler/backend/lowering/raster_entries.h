// SPDX-License-Identifier: Apache-2.0
// Raster results that stay where compute shaders find them: K entries of 64 bits a pixel, rank after rank, each its key
// in bits 36 to 59, the face in 4 to 35 and the tag below, all ones where there is none. What reads a face or a tag
// takes it out of the entry, so that no pass over all pixels unpacks them, and a shader binds one buffer for all ranks.
// Without atomics of 64 bits the walk's last dispatch makes the entries, whose keys are 0.
#pragma once

#include "compiler/backend/schedule/schedule.h"
#include "compiler/target/profile.h"

namespace dr::backend {

// Gives all results of a raster by compute shaders one resource, its entries; unless one of them is an output, an
// update or pinned, and so needs memory of its own. Where lanes take turns at atomics, a raster that is only asked if a
// pixel sees a face has no entries but a bit a pixel, which says that, and the maps are gone that would have made these
// bits of its faces (RasterPass::rows). Requires that no pass refers to another.
void keep_entries(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule);

}  // namespace dr::backend
