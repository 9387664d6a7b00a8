// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/options.h"

#include <algorithm>

#include "compiler/backend/skips.h"

namespace dr::backend {

std::variant<CompileOptions, std::string> compile_options(const std::string& lower, const std::string& raster,
                                                          const std::string& pack,
                                                          const std::vector<std::string>& ablate,
                                                          const std::string& scatter,
                                                          const std::string& float_profile) {
  CompileOptions out;
  if (lower == "fragment")
    out.lower = Lower::Fragment;
  else if (lower == "compute")
    out.lower = Lower::Compute;
  else if (lower != "auto")
    return "unknown lowering '" + lower + "'; there are auto, fragment and compute";
  if (raster == "hardware")
    out.raster = RasterLower::Hardware;
  else if (raster == "compute")
    out.raster = RasterLower::Compute;
  else if (raster != "auto")
    return "unknown raster lowering '" + raster + "'; there are auto, hardware and compute";
  if (pack == "naive")
    out.fused = out.recompute = out.stages = false;
  else if (pack != "fused")
    return "unknown packing '" + pack + "'; there are fused and naive";
  if (scatter == "exact")
    out.scatter = ScatterLower::Exact;
  else if (scatter == "rows")
    out.scatter = ScatterLower::Rows;
  else if (scatter == "atomic")
    out.scatter = ScatterLower::Atomic;
  else if (scatter != "auto")
    return "unknown scatter lowering '" + scatter + "'; there are auto, exact, rows and atomic";
  if (float_profile == "native")
    out.native_floats = true;
  else if (float_profile != "strict")
    return "unknown float profile '" + float_profile + "'; there are strict and native";
  for (const std::string& part : ablate) {
    if (part == "substages")
      out.fused = false;
    else if (part == "stages")
      out.stages = false;
    else if (part == "remat")
      out.recompute = false;
    else if (part == "cache")
      out.prologue = false;
    else if (part == "active")
      out.list_active = false;
    else if (part == "stepped")
      out.leave_at_rest = false;
    else if (part == "branches")
      out.list_branches = false;
    else if (part == "blocks")
      out.block_loops = false;
    else if (part == "guesses")
      out.guess_exponents = false;
    else if (part == "emptying")
      out.empty_sums = false;
    else if (part == "slots")
      out.share_memory = false;
    else if (std::ranges::find(kSkips, part) == std::end(kSkips))
      return "unknown part '" + part +
             "' to switch off; there are substages, stages, remat, cache, blocks, guesses and "
             "emptying";
  }
  return out;
}

PackOptions pack_options(const target::Profile& profile, const CompileOptions& options) {
  PackOptions out;
  out.fused = options.fused;
  out.recompute = options.recompute;
  out.stages = options.stages;
  out.prologue = options.prologue;
  out.moving = options.moving;
  out.blocks = options.block_loops;
  out.fragment = options.lower == Lower::Fragment || (options.lower == Lower::Auto && profile.lower == "fragment");
  out.hardware_raster =
      options.raster == RasterLower::Hardware || (options.raster == RasterLower::Auto && profile.raster == "hardware");
  return out;
}

}  // namespace dr::backend
