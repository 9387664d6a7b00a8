// SPDX-License-Identifier: Apache-2.0
// The families of the op table, one file each: every function gives the entries of its file, in any order. op.cpp puts
// them together.
#pragma once

#include <span>
#include <string_view>
#include <vector>

#include "compiler/ops/op.h"

namespace dr::ops {

std::vector<OpInfo> source_ops();      // Leaf, Const, Coord, DimValue, StepIndex
std::vector<OpInfo> arithmetic_ops();  // Add .. SMul
std::vector<OpInfo> math_ops();        // Floor .. Erf
std::vector<OpInfo> integer_ops();     // BitAnd .. Bitcast
std::vector<OpInfo> logic_ops();       // Less .. Convert
std::vector<OpInfo> vector_ops();      // Splat .. Normalize
std::vector<OpInfo> image_ops();       // Gather .. Broadcast
std::vector<OpInfo> region_ops();      // If, Reduce
std::vector<OpInfo> raster_ops();      // Raster
std::vector<OpInfo> gradient_ops();    // Grad, Vjp, Cotangent, Detach, Pin, Unlikely

// All of them, in the order of ir/op_kinds.def.
struct Family {
  std::string_view title;
  std::vector<OpInfo> (*entries)();
};
std::span<const Family> families();

}  // namespace dr::ops
