// SPDX-License-Identifier: Apache-2.0
// Compiling at run time: a `.dr` file -> the bytes of a bundle. The only part of the runtime that knows the compiler.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <variant>
#include <vector>

namespace dr::jit {

struct Options {
  std::string profile;                   // a built-in name or a file
  std::string lower = "auto";            // auto, fragment, compute
  std::string raster = "auto";           // auto, hardware, compute
  std::string pack = "fused";            // fused, naive
  std::vector<std::string> ablate;       // substages, stages, remat, and the names of compiler/backend/skips.h
  std::string scatter = "auto";          // auto, exact, rows, atomic
  std::string float_profile = "strict";  // strict, native
  bool shader_cache = true;              // keep assembled shaders on disk
  std::vector<std::string> include_dirs;
  std::map<std::string, std::string, std::less<>> defines;
  friend bool operator==(const Options&, const Options&) = default;
};

// The work of one thing that can be left out (docs/explain/skipping.md): what is done, and what is left out.
struct Skip {
  std::string id, unit;
  int64_t done = 0, avoided = 0;
};

// Those that --no-skip knows of compiling.
std::vector<std::string> skip_names();

// The bundle, or the diagnostics as they are to be printed. `skips`, if not null, gets what compiling left out.
std::variant<std::vector<uint8_t>, std::string> compile_file(const std::string& path, const Options& options,
                                                             std::vector<Skip>* skips = nullptr);

// Where compiled things are kept between runs: DRC_CACHE_DIR and so on (compiler/backend/spirv/shader_cache.h); may be
// empty.
std::string cache_folder();

}  // namespace dr::jit
