// SPDX-License-Identifier: Apache-2.0
// What a raster's attributes say; see compiler/ops/raster.cpp.
#pragma once

#include "compiler/ir/graph.h"

namespace dr::ir {

// What the fourth number of a raster's attributes asks for.
constexpr int64_t kListed = 1, kOrdered = 2;

// Whether its one result lists the faces of all ranks.
inline bool lists_faces(const Attrs& attrs) { return attrs.ints.size() > 3 && attrs.ints[3] == kListed; }

// The results of a rank, in this order; the last one only where it is asked for.
enum class RasterResult : uint8_t { Face, Tag, Order };
inline size_t results_a_rank(const Attrs& attrs) { return attrs.ints.size() > 3 && attrs.ints[3] == kOrdered ? 3 : 2; }

// The order of depth 1, and where there is no face: 2^24 - 1.
constexpr int32_t kLastOrder = 16777215;

}  // namespace dr::ir
