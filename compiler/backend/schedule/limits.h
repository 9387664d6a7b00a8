// SPDX-License-Identifier: Apache-2.0
// Whether a device can bind what a shader reads and writes. The schedule's checker counts for itself.
#pragma once

#include <cstdint>

#include "compiler/target/profile.h"

namespace dr::backend {

// Resources of one shader: those it reads, by how they are stored, and those it writes.
struct Bindings {
  uint32_t buffers = 0;
  uint32_t images = 0;
  uint32_t writes = 0;
  bool hardware = false;  // a fragment shader: what it writes are colour attachments, otherwise buffers
};

// That lowering a scatter may add to what its pass reads and writes: sums or tables, and lists.
inline constexpr uint32_t kScatterBuffers = 3;

bool fits(const target::Profile& profile, const Bindings& bindings);

}  // namespace dr::backend
