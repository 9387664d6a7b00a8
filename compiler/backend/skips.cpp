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

std::vector<std::pair<std::string, std::string>> build_defines(std::span<const std::string> off,
                                                               const target::Profile& profile) {
  const double operations = profile.costs.dispatch_ns * profile.costs.compute_operations_per_ns;
  return {{"std.build.skips", std::ranges::find(off, "soft") == off.end() ? "true" : "false"},
          {"std.build.dispatch_operations", std::to_string(operations)}};
}

std::vector<SkipCount> left_out_of_graph(const ir::Graph& graph, const passes::Skips::LeftOut& left_out) {
  const auto ops = static_cast<int64_t>(graph.op_count());
  const auto count = [&](const char* id, size_t avoided) {
    return SkipCount{id, "ops", ops, static_cast<int64_t>(avoided)};
  };
  return {count("dead", left_out.dead),
          count("zero", left_out.zero),
          count("fold", left_out.fold),
          count("share", left_out.share),
          {"layers", "layers", static_cast<int64_t>(left_out.layers_kept), static_cast<int64_t>(left_out.layers)}};
}

}  // namespace dr::backend
