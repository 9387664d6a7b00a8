// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "bundle_generated.h"

namespace dr::bundle {

// What a command touches, each once for each way in which it does.
struct Touched {
  uint32_t resource;
  bool written;
};
std::vector<Touched> touched_by(const CommandT& command);

}  // namespace dr::bundle
