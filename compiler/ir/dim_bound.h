// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "compiler/ir/dim.h"

namespace dr::ir {

// An expression that is nowhere smaller than this one, nor than 0, for symbols of at least 1.
Dim most_of(const Dim& dim);

// Whether it is surely 0 or less, for symbols of at least 1.
bool never_above_zero(const Dim& dim);

}  // namespace dr::ir
