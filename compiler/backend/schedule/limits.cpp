// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/schedule/limits.h"

namespace dr::backend {

bool fits(const target::Profile& profile, const Bindings& b) {
  const uint32_t bound = b.buffers + (b.hardware ? 0 : b.writes);
  if (bound > profile.max_per_stage_descriptor_storage_buffers ||
      b.images + (profile.lanes_in_turn ? b.buffers : 0) > profile.max_per_stage_descriptor_sampled_images ||
      b.buffers + b.images + b.writes > profile.max_per_stage_resources)
    return false;
  if (!b.hardware) return true;
  return b.writes <= profile.max_color_attachments &&
         bound + b.writes <= profile.max_fragment_combined_output_resources;
}

}  // namespace dr::backend
