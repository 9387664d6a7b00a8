// SPDX-License-Identifier: Apache-2.0
// Why a gradient is what it is, of a program's text.
#pragma once

#include <string>
#include <variant>

#include "runtime/jit/jit.h"

namespace dr::jit {

struct Explanation {
  std::string json;  // {"flows", "summary", "text", "paths", "more_paths", "clamps", "cuts"}
};

// Of an output or `let` with respect to a leaf or `let`; the second: diagnostics, or why there is no such value.
std::variant<Explanation, std::string> explain_gradient(const std::string& name, const std::string& text,
                                                        const Options& options, const std::string& loss,
                                                        const std::string& target);

}  // namespace dr::jit
