// SPDX-License-Identifier: Apache-2.0
// A shader for buffers that are bound in several parts, where one binding of the device takes less than they hold.
#pragma once

#include <compare>
#include <cstdint>
#include <span>
#include <string>
#include <variant>
#include <vector>

namespace dr::bundle {

struct Split {
  uint32_t binding = 0;  // of the buffer, from now on of its first part
  uint32_t more = 0;     // of the second part; the others follow
  uint32_t parts = 2;
  uint32_t log_size = 8;  // each part, but for the last, takes 2^log_size bytes, or of a texel buffer so many texels
  auto operator<=>(const Split&) const = default;
};

// The module in which each load, store and atomic of these buffers is a call of a function that looks which part the
// element is in. Nothing else changes: results have the same bits. Of a valid module, whose buffers are lists of
// numbers or of short vectors; or one sentence on what of it cannot be split.
std::variant<std::vector<uint32_t>, std::string> split_buffers(std::span<const uint32_t> module,
                                                               std::span<const Split> splits);

}  // namespace dr::bundle
