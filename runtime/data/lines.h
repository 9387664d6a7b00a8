// SPDX-License-Identifier: Apache-2.0
// Source lines in messages.
#pragma once

#include <span>
#include <string>

namespace dr::runtime {

// "fit.dr:7, std/points.dr:39 and 46 more": a user's own lines come first, and the library's are many.
inline std::string few_of(std::span<const std::string> lines) {
  constexpr size_t kMost = 6;
  std::string out;
  for (size_t k = 0; k < lines.size() && k < kMost; ++k) out += (k == 0 ? "" : ", ") + lines[k];
  return lines.size() > kMost ? out + " and " + std::to_string(lines.size() - kMost) + " more" : out;
}

}  // namespace dr::runtime
