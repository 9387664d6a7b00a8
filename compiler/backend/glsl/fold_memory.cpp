// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/glsl/fold_memory.h"

#include <algorithm>

#include "compiler/ir/yields.h"

namespace dr::backend::glsl {

namespace {

// Words of an invocation. Devices keep arrays in memory, for as many invocations as may be under way: half a kilobyte
// for each lane of a large GPU is a hundred megabytes.
constexpr int64_t kWords = 512;
// With fewer checkpoints a trip is computed again so often that memory is cheaper: 3 times for 1,000 trips with 16.
constexpr int64_t kLeastSlots = 16, kMostSlots = 128;

}  // namespace

FoldMemory fold_memory(const ir::Graph& graph, const ir::Op& op) {
  const size_t sweeps = ir::fold_sweeps(op);
  if (sweeps == 1) return {};
  int64_t words = 0;
  for (size_t s = 0; s + 1 < sweeps; ++s)
    for (const ir::ValueId start : ir::fold_starts(op, s)) words += graph.value(start).type.components();
  if (words == 0) return {.how = FoldMemory::How::All, .slots = 0};
  const int64_t slots = std::clamp(kWords / words, kLeastSlots, kMostSlots), bound = ir::fold_bound(op);
  // More sweeps than two have no checkpoints: `compile` refuses what has no bound.
  if (sweeps > 2 || (bound >= 0 && bound <= std::max(slots, kWords / words)))
    return {.how = FoldMemory::How::All, .slots = bound};
  return {.how = FoldMemory::How::Checkpoints, .slots = slots};
}

}  // namespace dr::backend::glsl
