// SPDX-License-Identifier: Apache-2.0
// Device profiles: limits and features that packing respects, what things cost, and which lowering suits the device.
// Profiles are data (profiles/*.json); the built-in ones are embedded in the compiler.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

namespace dr::target {

// What things cost on the device. Packing compares sums of these; a factor of two decides little, an order of magnitude
// much.
struct Costs {
  // Fixed costs, in ns: a render pass, a further subpass in one, a dispatch that waits for the one before.
  double pass_ns = 0;
  double subpass_ns = 0;
  double dispatch_ns = 0;
  // Memory traffic, in bytes per ns (GB/s): by the stage that moves it and by where the value lives.
  double fragment_image_bytes_per_ns = 0;
  double fragment_input_bytes_per_ns = 0;  // read as an input attachment
  double fragment_buffer_bytes_per_ns = 0;
  double compute_image_bytes_per_ns = 0;
  double compute_buffer_bytes_per_ns = 0;
  // Additions and multiplications per ns over the whole device.
  double fragment_operations_per_ns = 0;
  double compute_operations_per_ns = 0;
  double atomic_add_ns = 0;  // one uncontended 32-bit addition to a buffer, amortised
  // Raster: a triangle's fixed cost, and one of a pixel that is drawn (hardware) or tested in a box (compute).
  double hardware_triangle_ns = 0;
  double hardware_pixel_ns = 0;
  double compute_triangle_ns = 0;
  double compute_pixel_ns = 0;
  // What the driver takes to compile a small shader, in ms.
  double fragment_compile_ms = 0;
  double compute_compile_ms = 0;
};

struct Profile {
  std::string name;
  std::string description;
  // Limits, under Vulkan's names.
  uint32_t max_color_attachments = 4;
  uint32_t max_per_stage_descriptor_storage_buffers = 4;
  uint32_t max_per_stage_descriptor_sampled_images = 16;
  uint32_t max_per_stage_descriptor_input_attachments = 4;
  uint32_t max_per_stage_resources = 128;
  uint32_t max_fragment_combined_output_resources = 4;  // storage buffers and attachments that it writes
  uint32_t max_push_constants_size = 128;
  uint32_t max_image_dimension_2d = 4096;
  uint32_t max_compute_work_group_invocations = 128;
  uint32_t max_compute_work_group_count_x = 65535;
  uint32_t max_compute_shared_memory_size = 16384;
  uint32_t max_multiview_view_count = 0;  // 0: no multiview
  uint32_t subgroup_size = 1;
  uint64_t max_storage_buffer_range = 1u << 27;
  // How many trips the driver lets all loops of an invocation take together before it ends them without a word; 0: any
  // number. See trips.h of the backend.
  uint32_t loop_trips = 0;
  // Features.
  bool subgroup_arithmetic = false;  // ballots and sums over the lanes of a subgroup, in compute shaders
  bool subgroup_shuffle = false;     // and what other lanes have
  // Storage buffers are accessed one lane after the other, as by llvmpipe. What a shader only reads is then a uniform
  // texel buffer, and what it stores is hidden from the driver's compiler, which would compute that in turn too.
  bool lanes_in_turn = false;
  // The driver's compiler takes twice as long for each `else` within a loop, as SwiftShader's. Shaders have none then.
  bool else_doubles_compile = false;
  bool shader_int64 = false;
  bool shader_buffer_int64_atomics = false;
  bool shader_buffer_float32_atomic_add = false;
  bool fragment_stores_and_atomics = false;
  bool geometry_shader = false;
  Costs costs;
  // What `auto` means on this device: "fragment" or "compute"; "hardware" or "compute".
  std::string lower = "compute";
  std::string raster = "compute";

  // A GPU starts many lanes at once, and waits longer between dispatches than small ones take.
  bool is_gpu() const { return subgroup_size >= 16; }
};

// A built-in profile by name, or a file (JSON) when the name has a '.' or '/'. The error names the wrong or missing
// field, or suggests the nearest built-in name.
std::variant<Profile, std::string> load_profile(std::string_view name_or_path);
// A profile of our own form, or what tools report of a device (see device_report.h). `origin` is named in errors.
std::variant<Profile, std::string> parse_profile(std::string_view json, std::string_view origin);
std::vector<std::string> builtin_profiles();
// The profile in our own form: what parse_profile() reads.
std::string write_profile(const Profile& profile);

}  // namespace dr::target
