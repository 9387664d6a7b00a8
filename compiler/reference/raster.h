// SPDX-License-Identifier: Apache-2.0
// The Raster op: which faces does a pixel see. The contract is the comment of compiler/ops/raster.cpp.
#pragma once

#include <span>

#include "compiler/reference/region.h"

namespace dr::reference {

// What the functions of a raster did that they should not.
struct RasterFindings {
  Origin first;  // when tracing: the first NaN or Inf made in one of them
  // Candidates that `keep` kept although the pixel lies outside the hull of the corners: how many, and the first.
  // Looked for in the box around the corners and one pixel more.
  int64_t outside = 0;
  int32_t face = 0, x = 0, y = 0, layer = 0;
};

// Fills the result images: face 0, tag 0, face 1, ...
RasterFindings run_raster(const Context& context, const ir::Op& op, std::span<Image* const> results, Workers& workers);
// Fills those that say how faces are ordered, if there are any, by the faces.
void order_faces(const Context& context, const ir::Op& op, std::span<Image* const> results);

}  // namespace dr::reference
