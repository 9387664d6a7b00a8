// SPDX-License-Identifier: Apache-2.0
// What `drc explain` says about a code: dsl/diagnostic/explanations.md, which is part of the program.
#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "dsl/diagnostic/diagnostic.h"

namespace dr::dsl {

// The code of a name such as "E0312" (or "e0312"); nothing for others.
std::optional<Code> find_code(std::string_view name);

// The codes' names, in order.
std::vector<std::string> code_names();

// Summary, paragraph, wrong and right example as text that ends with a newline. Each code has one; a test checks it.
std::string explain(Code code);

}  // namespace dr::dsl
