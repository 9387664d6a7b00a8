// SPDX-License-Identifier: Apache-2.0
// How a program is compiled: the one list of options, in the words of the command line.
#pragma once

#include <map>
#include <string>
#include <vector>

namespace dr::driver {

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
  std::vector<std::string> adjoints;  // STEP:LEAF,...:OUTPUT,...: steps to be added (passes::add_adjoint)
  bool plain_gradients = false;       // differentiate functions that have a @vjp by their own text
  friend bool operator==(const Options&, const Options&) = default;
};

}  // namespace dr::driver
