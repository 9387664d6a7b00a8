// SPDX-License-Identifier: Apache-2.0
// The second half of the compiler in one call: differentiated graph -> bundle.
#pragma once

#include <filesystem>
#include <string>
#include <variant>
#include <vector>

#include "compiler/backend/bundle/bundle.h"
#include "compiler/backend/legalize_scatter.h"
#include "compiler/backend/schedule.h"
#include "compiler/backend/source_lines.h"
#include "compiler/ir/graph.h"
#include "compiler/target/profile.h"

namespace dr::backend {

enum class Lower : uint8_t { Auto, Fragment, Compute };
enum class RasterLower : uint8_t { Auto, Hardware, Compute };

struct CompileOptions {
  bool fused = true, recompute = true, stages = true, prologue = true;  // see PackOptions
  bool list_active = true;    // scatters run for the elements that may add something (scatter_active.h)
  bool list_branches = true;  // heavy branches run for the elements that take them (generate_listed.cpp)
  bool share_memory = true;   // see plan_memory()
  Lower lower = Lower::Auto;
  RasterLower raster = RasterLower::Auto;
  ScatterLower scatter = ScatterLower::Auto;
  bool native_floats = false;          // the float profile, docs/explain/README.md
  Moving moving;                       // see PackOptions
  SourceLines lines;                   // of the graph's ops, for the bundle
  std::filesystem::path cache_folder;  // of assembled shaders; empty: none
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

struct GlslShader {
  std::vector<std::string> names;  // of the passes that it is for
  bundle::Stage stage = bundle::Stage::Compute;
  std::string source;
  bool native = false;  // arithmetic of main is the driver's to contract
};

struct Compiled {
  Schedule schedule;
  std::vector<GlslShader> glsl;  // as in bundle.shaders, in order
  bundle::BundleT bundle;
  size_t shaders_found = 0;  // in the cache; the others were assembled
};

// `graph` has no Grad ops. The error is a limit of the profile that cannot be met, in one sentence.
std::variant<Compiled, std::string> compile(const ir::Graph& graph, const target::Profile& profile,
                                            const CompileOptions& options);

PackOptions pack_options(const target::Profile& profile, const CompileOptions& options);

}  // namespace dr::backend
