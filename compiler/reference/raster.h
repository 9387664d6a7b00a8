// SPDX-License-Identifier: Apache-2.0
// The Raster op: which faces does a pixel see. The contract is the comment of compiler/ops/raster.cpp.
#pragma once

#include <span>

#include "compiler/reference/region.h"

namespace dr::reference {

// Fills the result images: face 0, tag 0, face 1, ...
void run_raster(const Context& context, const ir::Op& op, std::span<Image* const> results, Workers& workers);

}  // namespace dr::reference
