// SPDX-License-Identifier: Apache-2.0
// Compiling at run time: a `.dr` file -> the bytes of a bundle. The only part of the runtime that knows the compiler.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "compiler/driver/options.h"
#include "compiler/io/file/result.h"

namespace dr::jit {

using Options = driver::Options;

// The work of one thing that can be left out (docs/explain/skipping.md): what is done, and what is left out.
struct Skip {
  std::string id, unit;
  int64_t done = 0, avoided = 0;
};

// Those that --no-skip knows of compiling.
std::vector<std::string> skip_names();

// What compiling has to tell besides the bundle.
struct Told {
  std::string warnings;  // as they are to be printed
  std::vector<Skip> skips;
};

// The bundle; an error has the diagnostics as they are to be printed, with a line break behind each.
io::Result<std::vector<uint8_t>> compile_file(const std::string& path, const Options& options, Told* told = nullptr);

// Where compiled things are kept between runs: DRC_CACHE_DIR and so on (compiler/backend/spirv/shader_cache.h); may be
// empty.
std::string cache_folder();

}  // namespace dr::jit
