// SPDX-License-Identifier: Apache-2.0
// What has to be done to a divisor so that devices divide as the language says.
#pragma once

#include "compiler/ir/graph.h"

namespace dr::backend {

// Whether `v` is hidden from the driver where something is divided by it, which else may make something else of the
// quotient. lavapipe's gives garbage for one by a zero that it sees at compile time; NVIDIA's takes x / sqrt(y) for x
// inversesqrt(y), a quotient by a known number for a product with its inverse, and 1 / (1 / x) for x, also of what is
// precise. Mesa's takes 1 / (1 + x * x) for greater than 0, also where the divisor is Inf: in the profile `native`, as
// strict quotients by what may be as large are no division of the driver's. Where the divisor comes from another shader
// it cannot, and the bits would depend on how ops are packed: in the profile `native` they may.
bool hide_as_divisor(const ir::Graph& graph, ir::ValueId v, bool native);

// Whether `v` is surely no larger than 2^126 and a few bits, up to which devices divide as they should.
bool is_moderate(const ir::Graph& graph, ir::ValueId v);

}  // namespace dr::backend
