// SPDX-License-Identifier: Apache-2.0
#include "compiler/io/array/checked.h"

#include "compiler/io/file/failure.h"

namespace dr::io {

size_t checked_byte_count(ElementKind kind, int64_t components, int64_t width, int64_t height, int64_t layers) {
  auto left = static_cast<uint64_t>(kMaxArrayBytes);
  uint64_t total = 1;
  for (const int64_t factor : {static_cast<int64_t>(scalar_size(kind)), components, width, height, layers}) {
    if (factor <= 0) fail("an array of ", width, "x", height, "x", layers, " elements is empty");
    if (static_cast<uint64_t>(factor) > left) {
      fail("an array of ", width, "x", height, "x", layers, " elements with ", components, " x ", kind_name(kind),
           " is larger than ", kMaxArrayBytes, " bytes");
    }
    total *= static_cast<uint64_t>(factor);
    left /= static_cast<uint64_t>(factor);
  }
  return static_cast<size_t>(total);
}

Array checked_zeros(ElementKind kind, int64_t components, int64_t width, int64_t height, int64_t layers) {
  checked_byte_count(kind, components, width, height, layers);
  return Array::zeros(kind, static_cast<int>(components), width, height, layers);
}

}  // namespace dr::io
