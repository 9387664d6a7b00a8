// SPDX-License-Identifier: Apache-2.0
// Scatters to few elements add floats in bins: whole numbers over all exponents that a float has (glsl/bins.h). Their
// sums are rounded once, whatever the order and the number of runs or ranks that they come from.
//   %g = scatter_add %i, %x -> [300]      each number has 9 bins of 64 bits
//   %g = scatter_add %i, %x -> [V]        an exponent of the largest contribution, see emit/fixed_sums.cpp
// Which way a sum goes is part of what it means, so it follows from the program alone: all roads agree on it.
#pragma once

#include <span>

#include "compiler/backend/analysis/named_once.h"
#include "compiler/ir/graph.h"

namespace dr::backend {

// Of a number.
inline constexpr int kBins = 9;
// Bins of more elements would not stay in caches, and take memory that a larger list has no room for.
inline constexpr int64_t kMostBinned = 1024;

// Whether sums of floats into an image of that extent are added in bins. An extent that data decides is none.
inline bool adds_in_bins(const ir::Extent& extent) {
  const ir::Dim count = extent.w * extent.h * extent.l;
  return count.is_constant() && count.constant() <= kMostBinned;
}

// Whether a sum of these scatter results is.
inline bool adds_in_bins(const ir::Graph& graph, ir::ValueId sum, std::span<const ir::ValueId> terms) {
  const ir::ValueInfo& info = graph.value(sum);
  return info.type.is_float() && adds_in_bins(info.extent) && !named_once(graph, terms);
}

}  // namespace dr::backend
