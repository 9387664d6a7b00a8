// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>

#include "compiler/ir/dim.h"

namespace dr::ir {

// An expression that is nowhere smaller than this one, nor than 0, for symbols of at least 1.
Dim most_of(const Dim& dim);

// Whether it is surely 0 or less, for symbols of at least 1.
bool never_above_zero(const Dim& dim);

// The largest whole number that dividend / by is not below for symbols of at least 1: nothing where it grows with them.
// `by` > 0. Floors of the dividend may be anything that they round, so it may be more than needed.
std::optional<int64_t> most_of_quotient(const Dim& dividend, int64_t by);

}  // namespace dr::ir
