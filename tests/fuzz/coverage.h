// SPDX-License-Identifier: Apache-2.0
// Where the code under test has been since the process began, as GCC's -fsanitize-coverage=trace-pc tells (preset
// `fuzz`). Without that option nothing is told, and all counts stay 0.
#pragma once

#include <cstdint>

namespace dr::fuzz {

struct Coverage {
  uint64_t blocks = 0;  // of instructions without a branch
  uint64_t edges = 0;   // from one to the next, those to one block in eight sorts
};

Coverage coverage();

}  // namespace dr::fuzz
