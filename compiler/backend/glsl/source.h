// SPDX-License-Identifier: Apache-2.0
// The text of a shader on its way to SPIR-V.
#pragma once

#include <set>
#include <string>
#include <vector>

#include "bundle_generated.h"

namespace dr::backend {

struct GlslShader {
  std::vector<std::string> names;  // of the passes that it is for
  bundle::Stage stage = bundle::Stage::Compute;
  std::string source;
  bool native = false;                    // arithmetic of main is the driver's to contract
  std::set<std::string> extensions = {};  // of GLSL that it requires
};

}  // namespace dr::backend
