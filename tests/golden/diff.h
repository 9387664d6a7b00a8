// SPDX-License-Identifier: Apache-2.0
// Unified diffs of short texts, for the messages of the golden runner.
#pragma once

#include <string>
#include <string_view>

namespace dr::golden {

// Empty when the texts are equal. Three lines of context; a missing last newline is said as in diff(1).
std::string unified_diff(std::string_view before, std::string_view after, const std::string& before_name,
                         const std::string& after_name);

}  // namespace dr::golden
