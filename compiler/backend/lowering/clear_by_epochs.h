// SPDX-License-Identifier: Apache-2.0
// Entries of rasters that are cleared once in kEpochs runs. The upper four bits of an entry say in which of these runs,
// its epoch, it was made; an entry of another epoch is none. Epochs count down, so that an entry wins against those of
// earlier runs by the same atomic minimum.
//   entries buffer seen : uvec2[W, H]          =>      epoch entries buffer seen : uvec2[W, H]
// Behind the entries lie the epoch of the run and that of the next one, in the first words of two elements. The clear
// takes the second over as the first; where that is 0, as in new memory, it clears all and begins with kEpochs. The
// walk's first dispatch leaves the next epoch, before an entry is made. Both run, or neither.
// Only on GPUs: what a clear of a large picture writes takes as long there as a raster of it.
#pragma once

#include "compiler/backend/schedule/schedule.h"
#include "compiler/target/profile.h"

namespace dr::backend {

void clear_by_epochs(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule);

}  // namespace dr::backend
