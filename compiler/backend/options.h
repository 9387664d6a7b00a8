// SPDX-License-Identifier: Apache-2.0
// What a caller may ask of the back end.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "compiler/backend/analysis/source_lines.h"
#include "compiler/backend/bundle/bundle.h"
#include "compiler/backend/lowering/scatter.h"
#include "compiler/backend/pack/pack.h"
#include "compiler/target/profile.h"

namespace dr::backend {

enum class Lower : uint8_t { Auto, Fragment, Compute };
enum class RasterLower : uint8_t { Auto, Hardware, Compute };

// For those who watch the passes; see pipeline.h.
struct PassHooks {
  bool verify_each = false;  // the schedule or bundle is checked after each pass, not only at the end
  std::string stop_after;    // the last pass to run; empty: all do
  std::string break_after;   // the pass that is made to leave an unsound schedule or bundle, to see what comes of it
  // Called after each pass with its name, the graph, its schedule, or null beyond schedules, the bundle so far, and the
  // milliseconds it took.
  std::function<void(std::string_view, const ir::Graph&, const Schedule*, const bundle::BundleT&, double)> after = {};
};

struct CompileOptions {
  bool fused = true, recompute = true, stages = true, prologue = true;  // see PackOptions
  bool list_active = true;      // scatters run for the elements that may add something (lowering/scatter_active.h)
  bool leave_at_rest = true;    // updates leave elements out (lowering/leave_at_rest.h)
  bool list_branches = true;    // heavy branches run for the elements that take them (emit/listed.cpp)
  bool block_loops = true;      // see lowering/block_loops.h
  bool empty_sums = true;       // see lowering/empty_sums.h, and lowering/clear_by_epochs.h of rasters
  bool guess_exponents = true;  // see lowering/guess_exponents.h
  bool share_memory = true;     // see plan_memory()
  Lower lower = Lower::Auto;
  RasterLower raster = RasterLower::Auto;
  ScatterLower scatter = ScatterLower::Auto;
  bool native_floats = false;          // the float profile, docs/explain/floats.md
  Moving moving;                       // see PackOptions
  SourceLines lines;                   // of the graph's ops, for the bundle
  std::filesystem::path cache_folder;  // of assembled shaders; empty: none
  PassHooks hooks;
};

// The options from the words of the command line: auto|fragment|compute, auto|hardware|compute, fused|naive, what is
// switched off: substages, stages, remat (all three is naive), and the names of skips.h, of which those that are not
// the schedule's change nothing here, auto|exact|rows|atomic, and strict|native. The error names the word and those
// there are.
std::variant<CompileOptions, std::string> compile_options(const std::string& lower, const std::string& raster,
                                                          const std::string& pack,
                                                          const std::vector<std::string>& ablate = {},
                                                          const std::string& scatter = "auto",
                                                          const std::string& float_profile = "strict");

PackOptions pack_options(const target::Profile& profile, const CompileOptions& options);

}  // namespace dr::backend
