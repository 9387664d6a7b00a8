// SPDX-License-Identifier: Apache-2.0
// What a raster's attributes say; see compiler/ops/raster.cpp.
#pragma once

#include "compiler/ir/graph.h"

namespace dr::ir {

// Whether its one result lists the faces of all ranks.
inline bool lists_faces(const Attrs& attrs) { return attrs.ints.size() > 3 && attrs.ints[3] == 1; }

}  // namespace dr::ir
