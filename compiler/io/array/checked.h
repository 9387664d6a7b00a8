// SPDX-License-Identifier: Apache-2.0
// Arrays whose extent a file or a user chose. Private to compiler/io; every function throws Failure.
#pragma once

#include <cstddef>
#include <cstdint>

#include "compiler/io/array/array.h"

namespace dr::io {

// The product in bytes; fails when it is not positive or passes kMaxArrayBytes. Never wraps around.
size_t checked_byte_count(ElementKind kind, int64_t components, int64_t width, int64_t height, int64_t layers);

// Array::zeros for an extent that a file or a user chose: fails instead of asserting.
Array checked_zeros(ElementKind kind, int64_t components, int64_t width, int64_t height, int64_t layers);

}  // namespace dr::io
