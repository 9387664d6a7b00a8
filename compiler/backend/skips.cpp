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

std::vector<std::pair<std::string, std::string>> skip_defines(std::span<const std::string> off) {
  if (std::ranges::find(off, "soft") == off.end()) return {};
  return {{"std.hardsoftras.skips", "false"}};
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
