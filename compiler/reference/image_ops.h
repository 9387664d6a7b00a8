// SPDX-License-Identifier: Apache-2.0
// Ops of the root that are not regions, on whole images.
#pragma once

#include <span>

#include "compiler/reference/region.h"

namespace dr::reference {

// Any op of shape Source (but Leaf), Elementwise or Image. `result` has its size and undefined content.
void run_image_op(const Context& context, const ir::Op& op, Image& result, Workers& workers);

}  // namespace dr::reference
