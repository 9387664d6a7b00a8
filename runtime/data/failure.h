// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <utility>

#include "compiler/io/file/result.h"

namespace dr::runtime {

// Thrown inside the runtime, turned into a Result at its public functions.
struct Failure {
  std::string message;
  io::Blame blame = io::Blame::Given;
  io::Error error() const { return {message, blame}; }
};

// Of the device or the machine: what was asked for is right, and another one may do it.
struct DeviceFailure : Failure {
  explicit DeviceFailure(std::string what) {
    message = std::move(what);
    blame = io::Blame::Device;
  }
};

}  // namespace dr::runtime
