// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/schedule/limits.h"

#include <algorithm>

namespace dr::backend {

Bindings bindings_of(const std::vector<Resource>& resources, std::vector<uint32_t> reads, size_t writes,
                     bool hardware) {
  std::ranges::sort(reads);
  reads.erase(std::ranges::unique(reads).begin(), reads.end());
  const auto buffers =
      static_cast<uint32_t>(std::ranges::count_if(reads, [&](uint32_t r) { return resources[r].is_buffer(); }));
  return {buffers, static_cast<uint32_t>(reads.size()) - buffers, static_cast<uint32_t>(writes), hardware};
}

std::vector<uint32_t> resources_of(const StepSchedule& step, std::span<const ir::ValueId> values) {
  std::vector<uint32_t> out;
  for (const ir::ValueId v : values) out.push_back(step.stored.at(v).index);
  return out;
}

bool fits(const target::Profile& profile, const Bindings& b) {
  // What is only read is a texel buffer where lanes go in turn, which counts as a sampled image.
  const uint32_t texels = profile.lanes_in_turn ? b.buffers : 0;
  const uint32_t bound = b.buffers - texels + b.more + (b.hardware ? 0 : b.writes);
  if (bound > profile.max_per_stage_descriptor_storage_buffers ||
      b.images + texels > profile.max_per_stage_descriptor_sampled_images ||
      b.buffers + b.more + b.images + b.writes > profile.max_per_stage_resources)
    return false;
  if (!b.hardware) return true;
  return b.writes <= profile.max_color_attachments &&
         bound + b.writes <= profile.max_fragment_combined_output_resources;
}

}  // namespace dr::backend
