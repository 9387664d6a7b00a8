// SPDX-License-Identifier: Apache-2.0
// What makes a damaged file look whole again, so that fuzzing gets behind the check for damage.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace dr::fuzz {

// The file with the checksum of each PNG chunk made right.
inline std::vector<uint8_t> with_checksums(std::span<const uint8_t> bytes) {
  std::vector<uint8_t> file(bytes.begin(), bytes.end());
  for (size_t at = 8; at + 12 <= file.size();) {
    const size_t length = static_cast<size_t>(file[at]) << 24 | static_cast<size_t>(file[at + 1]) << 16 |
                          static_cast<size_t>(file[at + 2]) << 8 | static_cast<size_t>(file[at + 3]);
    if (length > file.size() - at - 12) break;
    uint32_t crc = 0xffffffffu;
    for (size_t i = at + 4; i < at + 8 + length; ++i) {
      crc ^= file[i];
      for (int bit = 0; bit < 8; ++bit) crc = (crc & 1) != 0 ? 0xedb88320u ^ (crc >> 1) : crc >> 1;
    }
    crc = ~crc;
    for (size_t k = 0; k < 4; ++k) file[at + 8 + length + k] = static_cast<uint8_t>(crc >> (24 - 8 * k));
    at += 12 + length;
  }
  return file;
}

}  // namespace dr::fuzz
