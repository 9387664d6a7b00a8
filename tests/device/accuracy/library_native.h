// SPDX-License-Identifier: Apache-2.0
// What the float profile `native` is allowed where a function of the library is made of drivers' built-ins.
#pragma once

#include <span>

#include "compiler/ir/graph.h"

namespace dr::accuracy::library {

// How many times as far as our own function a built-in may be off, of the op where that is most among those that make
// these values. Errors add up: where no op is off by more than so many times what it was, neither is a result. Fused
// multiply-adds round once less.
struct FurtherOff {
  double times = 1;
  ir::OpKind kind{};
};
FurtherOff further_off(const ir::Graph& graph, std::span<const ir::ValueId> roots);

}  // namespace dr::accuracy::library
