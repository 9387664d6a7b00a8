// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/analysis/fold_memory.h"

#include <algorithm>
#include <map>
#include <utility>

#include "compiler/ir/yields.h"

namespace dr::backend {

namespace {

// Words of an invocation. Devices keep arrays in memory, for as many invocations as may be under way: half a kilobyte
// for each lane of a large GPU is a hundred megabytes.
constexpr int64_t kWords = 512;
// Where there is no choice.
constexpr int64_t kMostWords = 16384;
// With fewer checkpoints a trip is computed again so often that memory is cheaper: 3 times for 1,000 trips with 16.
constexpr int64_t kLeastSlots = 16, kMostSlots = 128;

// Of the states that a later sweep may ask for.
int64_t words_of(const ir::Graph& graph, const ir::Op& op) {
  int64_t words = 0;
  for (size_t s = 0; s + 1 < ir::fold_sweeps(op); ++s)
    for (const ir::ValueId start : ir::fold_starts(op, s)) words += graph.value(start).type.components();
  return words;
}

}  // namespace

std::optional<std::string> folds_over_limit(const ir::Graph& graph, const SourceLines& lines) {
  // Loops of one line, of which the one that carries most is told.
  std::map<std::string, std::pair<int64_t, std::string>> found;
  for (uint32_t k = 0; k < graph.op_count(); ++k) {
    const ir::Op& op = graph.op(ir::OpId{k});
    if (op.kind != ir::OpKind::Fold || ir::fold_sweeps(op) < 3) continue;
    const int64_t words = words_of(graph, op), bound = ir::fold_bound(op);
    if (words == 0 || (bound >= 0 && bound <= kMostWords / words)) continue;
    const std::string& name = graph.value(graph.region(op.regions[0]).params.back()).name;
    const auto line = lines.of(ir::OpId{k});
    const std::string where = line ? lines.files()[line->file()] + ":" + std::to_string(line->line()) + ": " : "";
    auto& [most, text] = found[where + name];
    if (words <= most) continue;
    most = words;
    text = where + std::string("a gradient of a gradient stores what the loop") +
           (name.empty() ? "" : " over '" + name + "'") + " carries: promise at most " +
           std::to_string(kMostWords / words) + " trips with 'max'" +
           (bound < 0 ? "" : ", not " + std::to_string(bound));
  }
  std::string text;
  for (const auto& [place, told] : found) text += (text.empty() ? "" : "\n") + told.second;
  return text.empty() ? std::nullopt : std::optional(text);
}

FoldMemory fold_memory(const ir::Graph& graph, const ir::Op& op) {
  const size_t sweeps = ir::fold_sweeps(op);
  if (sweeps == 1) return {};
  const int64_t words = words_of(graph, op);
  if (words == 0) return {.how = FoldMemory::How::All, .slots = 0};
  const int64_t slots = std::clamp(kWords / words, kLeastSlots, kMostSlots), bound = ir::fold_bound(op);
  // More sweeps than two have no checkpoints, see folds_over_limit().
  if (sweeps > 2 || (bound >= 0 && bound <= std::max(slots, kWords / words)))
    return {.how = FoldMemory::How::All, .slots = bound};
  return {.how = FoldMemory::How::Checkpoints, .slots = slots};
}

// Each time, half of the slots that are free part the way to a trip. When none is left, a trip is as far from the
// nearest as these parts are long.
ir::Dim trips_again(const FoldMemory& memory, const ir::Dim& trips) {
  if (memory.how != FoldMemory::How::Checkpoints) return 0;
  int64_t parts = 1, times = 1;
  for (int64_t free = memory.slots - 1; free > 0; ++times) {
    const int64_t taken = (free + 1) / 2;
    parts = std::min(parts * (taken + 1), int64_t{INT32_MAX});
    free -= taken;
  }
  return trips * (ir::Dim(times) + trips.divided_by(parts));
}

}  // namespace dr::backend
