// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

namespace dr::runtime {

// Thrown inside the runtime, turned into a Result at its public functions.
struct Failure {
  std::string message;
};

}  // namespace dr::runtime
