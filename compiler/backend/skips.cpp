// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/skips.h"

#include <algorithm>

namespace dr::backend {

passes::Skips pass_skips(std::span<const std::string> off) {
  const auto is_on = [&](std::string_view id) { return std::ranges::find(off, id) == off.end(); };
  passes::Skips skips;
  skips.dead = is_on("dead");
  skips.zero = is_on("zero");
  skips.fold = is_on("fold");
  skips.share = is_on("share");
  return skips;
}

std::vector<std::pair<std::string, std::string>> skip_defines(std::span<const std::string> off,
                                                              const target::Profile& profile) {
  // Of outlines ten thousands of candidate pixels are left out at most, each some hundred operations, for which half a
  // dozen dispatches wait for each other: see docs/results/notebook.md.
  constexpr double kMostOperations = 1e7;
  const bool soft = std::ranges::find(off, "soft") == off.end();
  const bool outlines = profile.costs.dispatch_ns * profile.costs.compute_operations_per_ns < kMostOperations;
  std::vector<std::pair<std::string, std::string>> out;
  if (!soft) out.emplace_back("std.hardsoftras.skips", "false");
  if (!soft || !outlines) out.emplace_back("std.hardsoftras.outlines_skips", "false");
  return out;
}

std::vector<SkipCount> left_out_of_graph(const ir::Graph& graph, const passes::Skips::LeftOut& left_out) {
  const auto ops = static_cast<int64_t>(graph.op_count());
  const auto count = [&](const char* id, size_t avoided) {
    return SkipCount{id, "ops", ops, static_cast<int64_t>(avoided)};
  };
  return {count("dead", left_out.dead), count("zero", left_out.zero), count("fold", left_out.fold),
          count("share", left_out.share)};
}

}  // namespace dr::backend
