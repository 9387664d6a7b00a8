// SPDX-License-Identifier: Apache-2.0
// Device profiles: limits and features that packing respects, and which lowering suits the device. Profiles are data
// (profiles/*.json); the built-in ones are embedded in the compiler.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

namespace dr::target {

struct Profile {
  std::string name;
  std::string description;
  // Limits, under Vulkan's names.
  uint32_t max_color_attachments = 4;
  uint32_t max_per_stage_descriptor_storage_buffers = 4;
  uint32_t max_per_stage_descriptor_sampled_images = 16;
  uint32_t max_per_stage_resources = 128;
  uint32_t max_fragment_combined_output_resources = 4;
  uint32_t max_push_constants_size = 128;
  uint32_t max_image_dimension_2d = 4096;
  uint32_t max_compute_work_group_invocations = 128;
  uint64_t max_storage_buffer_range = 1u << 27;
  // Features.
  bool shader_int64 = false;
  bool shader_buffer_int64_atomics = false;
  bool fragment_stores_and_atomics = false;
  // What `auto` means on this device: "fragment" or "compute"; "hardware" or "compute".
  std::string lower = "compute";
  std::string raster = "compute";
};

// A built-in profile by name, or a file (JSON) when the name has a '.' or '/'. The error names the wrong or missing
// field, or suggests the nearest built-in name.
std::variant<Profile, std::string> load_profile(std::string_view name_or_path);
std::variant<Profile, std::string> parse_profile(std::string_view json, std::string_view origin);
std::vector<std::string> builtin_profiles();

}  // namespace dr::target
