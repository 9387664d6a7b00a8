// SPDX-License-Identifier: Apache-2.0
// What compiling may leave out of a program's work, by name: `--no-skip`. docs/explain/skipping.md says what each is.
#pragma once

#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "compiler/passes/passes.h"
#include "compiler/target/profile.h"

namespace dr::backend {

// `dead` to `layers` are of the graph, the others of its schedule, `soft` of the library.
inline constexpr std::string_view kSkips[] = {"dead",   "zero",    "fold",     "share", "layers", "slots",
                                              "active", "stepped", "branches", "soft",  "cache"};

// The passes' part of what is switched off.
passes::Skips pass_skips(std::span<const std::string> off);

// The library's part: the consts of std.build and their values, unless -D gives them others.
std::vector<std::pair<std::string, std::string>> build_defines(std::span<const std::string> off,
                                                               const target::Profile& profile);

// One skip's work: what is done, and what is left out.
struct SkipCount {
  std::string id, unit;
  int64_t done = 0, avoided = 0;
};

// Of the passes that made a graph.
std::vector<SkipCount> left_out_of_graph(const ir::Graph& graph, const passes::Skips::LeftOut& left_out);

}  // namespace dr::backend
