// SPDX-License-Identifier: Apache-2.0
// Limits and features of a device as tools report them.
#include "compiler/target/device_report.h"

#include <algorithm>
#include <map>
#include <nlohmann/json.hpp>
#include <string_view>

namespace dr::target {

namespace {

using nlohmann::json;

constexpr std::string_view kProperties = "VkPhysicalDeviceProperties", kFeatures = "VkPhysicalDeviceFeatures";

// All structures of a report: field -> value, under the field's name and, for limits, Vulkan's name of the limit. The
// same field may stand in several structures (of a version and of the extension it came from), with one value.
class Report {
 public:
  explicit Report(const json& root) {
    collect(root);
    if (const json* sets = member(root, "capabilities"))
      for (const auto& [name, set] : sets->items())
        for (const char* part : {"properties", "features"})
          if (const json* structures = member(set, part)) collect(*structures);
  }

  const json* field(const std::string& name) const {
    const auto it = fields_.find(name);
    return it == fields_.end() ? nullptr : it->second;
  }
  bool has_structure(std::string_view name) const { return structures_.count(std::string(name)) != 0; }

 private:
  static const json* member(const json& object, const char* name) {
    if (!object.is_object()) return nullptr;
    const auto it = object.find(name);
    return it == object.end() || !it->is_object() ? nullptr : &*it;
  }
  void collect(const json& structures) {
    for (const auto& [name, structure] : structures.items()) {
      if (!name.starts_with("VkPhysicalDevice") || !structure.is_object()) continue;
      structures_[name] = &structure;
      // The second forms of these structures hold the first ones.
      for (const char* inner : {"properties", "features"})
        if (const json* first = member(structure, inner)) take(*first);
      take(structure);
    }
  }
  void take(const json& structure) {
    for (const auto& [name, value] : structure.items()) fields_.try_emplace(name, &value);
    if (const json* limits = member(structure, "limits")) take(*limits);
  }

  std::map<std::string, const json*> structures_;
  std::map<std::string, const json*> fields_;
};

class Reader {
 public:
  explicit Reader(const Report& report) : report_(report) {}

  template <class T>
  void limit(const char* name, T& out) {
    const json* value = required(name);
    if (value == nullptr) return;
    if (value->is_array() && !value->empty()) value = &value->front();
    whole(name, *value, out);
  }
  // Left as it is where the report does not have the structure: the device may be older than the limit.
  template <class T>
  void optional_limit(const char* name, T& out) {
    if (const json* value = report_.field(name)) whole(name, *value, out);
  }
  void feature(const char* name, bool& out, bool must) {
    const json* value = must ? required(name) : report_.field(name);
    if (value == nullptr) return;
    if (value->is_boolean())
      out = value->get<bool>();
    else if (value->is_number_unsigned())  // VkBool32
      out = value->get<uint64_t>() != 0;
    else
      fail(name, "should be true or false");
  }
  // Flags are a list of names, or a number. False where the report does not have the field.
  bool has_flag(const char* name, const char* flag, uint64_t bit) {
    const json* value = report_.field(name);
    if (value == nullptr) return false;
    if (value->is_array()) return std::find(value->begin(), value->end(), flag) != value->end();
    if (value->is_number_unsigned()) return (value->get<uint64_t>() & bit) != 0;
    fail(name, "should be a list of flags");
    return false;
  }
  const json* required(const char* name) {
    const json* value = report_.field(name);
    if (value == nullptr) fail(name, "is missing");
    return value;
  }
  void fail(const char* name, const std::string& what) {
    if (problem.empty()) problem = "field '" + std::string(name) + "' " + what;
  }

  std::string problem;

 private:
  template <class T>
  void whole(const char* name, const json& value, T& out) {
    if (!value.is_number_unsigned()) return fail(name, "should be a whole number");
    const auto number = value.get<uint64_t>();
    if (number > std::numeric_limits<T>::max()) return fail(name, "is too large");
    out = static_cast<T>(number);
  }
  const Report& report_;
};

// The built-in profile whose costs are typical of a device type, which reports give by name or by number.
std::string_view typical_profile(const json* type) {
  if (type != nullptr) {
    if (*type == "VK_PHYSICAL_DEVICE_TYPE_CPU" || *type == 4) return "lavapipe";
    if (*type == "VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU" || *type == 1) return "intel-uhd620";
  }
  return "nvidia-rtx2080";
}

}  // namespace

bool is_device_report(const json& root) {
  const auto schema = root.find("$schema");
  const bool khronos = schema != root.end() && schema->is_string() &&
                       schema->get<std::string>().find("schema.khronos.org/vulkan") != std::string::npos;
  return khronos || root.contains("capabilities") || root.contains(kProperties) || root.contains(kFeatures);
}

std::variant<Profile, std::string> profile_from_report(const json& root) {
  const Report report(root);
  if (!report.has_structure(kProperties) && !report.has_structure("VkPhysicalDeviceProperties2"))
    return "a report of a device without 'VkPhysicalDeviceProperties': write one with  vulkaninfo --json";
  Reader r(report);
  const std::string_view like = typical_profile(report.field("deviceType"));
  Profile p = std::get<Profile>(load_profile(like));
  const json* name = report.field("deviceName");  // profiles for several devices have none
  p.name = name != nullptr && name->is_string() ? name->get<std::string>() : "reported device";
  p.description = "read from a device report; costs are those of " + std::string(like);
  r.limit("maxColorAttachments", p.max_color_attachments);
  r.limit("maxPerStageDescriptorStorageBuffers", p.max_per_stage_descriptor_storage_buffers);
  r.limit("maxPerStageDescriptorSampledImages", p.max_per_stage_descriptor_sampled_images);
  r.limit("maxPerStageDescriptorInputAttachments", p.max_per_stage_descriptor_input_attachments);
  r.limit("maxPerStageResources", p.max_per_stage_resources);
  r.limit("maxFragmentCombinedOutputResources", p.max_fragment_combined_output_resources);
  r.limit("maxPushConstantsSize", p.max_push_constants_size);
  r.limit("maxImageDimension2D", p.max_image_dimension_2d);
  r.limit("maxComputeWorkGroupInvocations", p.max_compute_work_group_invocations);
  r.limit("maxComputeWorkGroupCount", p.max_compute_work_group_count_x);
  r.limit("maxComputeSharedMemorySize", p.max_compute_shared_memory_size);
  r.limit("maxStorageBufferRange", p.max_storage_buffer_range);
  p.max_multiview_view_count = 0;
  p.subgroup_size = 1;
  p.subgroup_arithmetic = p.subgroup_shuffle = p.shader_buffer_int64_atomics = p.shader_buffer_float32_atomic_add =
      false;
  r.optional_limit("maxMultiviewViewCount", p.max_multiview_view_count);
  r.optional_limit("subgroupSize", p.subgroup_size);
  for (const char* operations : {"subgroupSupportedOperations", "supportedOperations"}) {
    if (!r.has_flag(operations, "VK_SUBGROUP_FEATURE_ARITHMETIC_BIT", 4) ||
        !r.has_flag(operations, "VK_SUBGROUP_FEATURE_BALLOT_BIT", 8))
      continue;
    p.subgroup_arithmetic = true;
    p.subgroup_shuffle = p.subgroup_shuffle || r.has_flag(operations, "VK_SUBGROUP_FEATURE_SHUFFLE_BIT", 16);
  }
  r.feature("shaderInt64", p.shader_int64, true);
  r.feature("fragmentStoresAndAtomics", p.fragment_stores_and_atomics, true);
  r.feature("geometryShader", p.geometry_shader, true);
  r.feature("shaderBufferInt64Atomics", p.shader_buffer_int64_atomics, false);
  r.feature("shaderBufferFloat32AtomicAdd", p.shader_buffer_float32_atomic_add, false);
  if (!r.problem.empty()) return r.problem;
  return p;
}

}  // namespace dr::target
