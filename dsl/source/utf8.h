// SPDX-License-Identifier: Apache-2.0
// The one UTF-8 rule of the front end: how long the sequence at a byte is. The lexer refuses texts
// that break it; the diagnostic formatter counts columns with it, in broken texts too.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string_view>

namespace dr::dsl {

// The length of the well-formed sequence at `at` (1 to 4), or 0: a stray continuation byte, an
// overlong form, a surrogate, a value past U+10FFFF, or a sequence that the text cuts off.
inline size_t utf8_length(std::string_view text, size_t at) {
  const auto byte = [&](size_t index) { return static_cast<uint8_t>(text[index]); };
  const auto continues = [&](size_t index) { return index < text.size() && (byte(index) & 0xC0) == 0x80; };
  const uint8_t first = byte(at);
  if (first < 0x80) return 1;
  if (first < 0xC2) return 0;
  if (!continues(at + 1)) return 0;
  const uint8_t second = byte(at + 1);
  if (first < 0xE0) return 2;
  if (!continues(at + 2)) return 0;
  if (first < 0xF0) {
    if (first == 0xE0 && second < 0xA0) return 0;
    if (first == 0xED && second > 0x9F) return 0;
    return 3;
  }
  if (first > 0xF4 || !continues(at + 3)) return 0;
  if (first == 0xF0 && second < 0x90) return 0;
  if (first == 0xF4 && second > 0x8F) return 0;
  return 4;
}

}  // namespace dr::dsl
