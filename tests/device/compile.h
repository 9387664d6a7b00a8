// SPDX-License-Identifier: Apache-2.0
// Compiling a program within a device test.
#pragma once

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "runtime/jit/jit.h"
#include "tests/catch.h"

namespace dr::test {

// The bundle of a file; an error fails the test.
inline std::vector<uint8_t> compile(const std::string& path, const jit::Options& options) {
  auto result = jit::compile_file(path, options);
  if (!result) FAIL(result.error());
  return std::move(result).value();
}

// The bundle of a program for a profile. `file`, in the build folder, is where the text is written to.
inline std::vector<uint8_t> compile_text(const std::string& file, const std::string& text, const std::string& profile) {
  const auto path = std::filesystem::path(DR_BUILD_DIR) / file;
  std::ofstream(path) << text;
  jit::Options options;
  options.profile = profile;
  return compile(path.string(), options);
}

// For a profile, with one of the forms of jit::Options::scatter.
inline std::vector<uint8_t> compile(const std::string& path, const std::string& profile, const std::string& scatter) {
  jit::Options options;
  options.profile = profile;
  options.scatter = scatter;
  return compile(path, options);
}

}  // namespace dr::test
