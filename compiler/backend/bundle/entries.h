// SPDX-License-Identifier: Apache-2.0
// What hosts read of a raster's entries (lowering/raster_entries.h).
#pragma once

#include <cstdint>

namespace dr::bundle {

// Where a raster says no more than whether pixels see a face, so many of a row share a word, the leftmost one its
// lowest bit.
inline constexpr int kBitsOfWord = 32;
// What a raster of one rank gives where it says no more than that there is a face.
inline constexpr int32_t kSomeFace = (1 << 28) - 1;

}  // namespace dr::bundle
