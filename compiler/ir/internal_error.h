// SPDX-License-Identifier: Apache-2.0
// What DR_ICE and DR_ASSERT throw: an invariant of the compiler is broken, and no input may do that. Commands print it,
// keep what reproduces it, and exit with a code of its own.
#pragma once

#include <exception>
#include <string>

namespace dr::ir {

class InternalError : public std::exception {
 public:
  explicit InternalError(std::string message) : message_(std::move(message)) {}
  // File and line in the compiler, and what is wrong.
  const char* what() const noexcept override { return message_.c_str(); }

 private:
  std::string message_;
};

}  // namespace dr::ir
