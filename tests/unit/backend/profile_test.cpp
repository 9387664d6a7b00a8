// SPDX-License-Identifier: Apache-2.0
// Device profiles: the built-in ones, and what is said of wrong ones.
#include "compiler/target/profile.h"

#include "tests/catch.h"

using dr::target::load_profile;
using dr::target::parse_profile;
using dr::target::Profile;

namespace {

std::string problem(const std::variant<Profile, std::string>& result) {
  const auto* text = std::get_if<std::string>(&result);
  return text ? *text : "";
}

bool contains(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

const char* const kSound =
    R"({"name": "x", "description": "", "max_color_attachments": 4, "max_per_stage_descriptor_storage_buffers": 8,
  "max_per_stage_descriptor_sampled_images": 16, "max_per_stage_descriptor_input_attachments": 4, "max_per_stage_resources": 44, "max_fragment_combined_output_resources": 8,
  "max_push_constants_size": 128, "max_image_dimension_2d": 8192, "max_compute_work_group_invocations": 128,
  "max_compute_work_group_count_x": 65535, "max_compute_shared_memory_size": 16384, "max_multiview_view_count": 6, "subgroup_size": 32,
  "max_storage_buffer_range": 134217728, "loop_trips": 0, "subgroup_arithmetic": false, "subgroup_shuffle": false, "lanes_in_turn": false, "else_doubles_compile": false, "shader_int64": false, "shader_buffer_int64_atomics": false,
  "shader_buffer_float32_atomic_add": false, "fragment_stores_and_atomics": true, "geometry_shader": false,
  "costs": {"pass_ns": 1, "subpass_ns": 0.5, "dispatch_ns": 1, "fragment_image_bytes_per_ns": 1, "fragment_input_bytes_per_ns": 1,
    "fragment_buffer_bytes_per_ns": 1, "compute_image_bytes_per_ns": 1, "compute_buffer_bytes_per_ns": 1, "fragment_operations_per_ns": 1,
    "compute_operations_per_ns": 1, "atomic_add_ns": 1, "hardware_triangle_ns": 1, "hardware_pixel_ns": 1, "compute_triangle_ns": 1,
    "compute_pixel_ns": 1, "fragment_compile_ms": 1, "compute_compile_ms": 1}, "lower": "fragment", "raster": "hardware"})";

std::string with(std::string text, const std::string& from, const std::string& to) {
  const size_t at = text.find(from);
  REQUIRE(at != std::string::npos);
  return text.replace(at, from.size(), to);
}

}  // namespace

TEST_CASE("every built-in profile is sound") {
  REQUIRE(dr::target::builtin_profiles().size() >= 2);
  for (const std::string& name : dr::target::builtin_profiles()) {
    const auto p = load_profile(name);
    INFO(problem(p));
    REQUIRE(std::holds_alternative<Profile>(p));
    CHECK(std::get<Profile>(p).name == name);
  }
}

TEST_CASE("a sound profile from text is read whole") {
  const auto p = parse_profile(kSound, "x.json");
  REQUIRE(std::holds_alternative<Profile>(p));
  CHECK(std::get<Profile>(p).max_image_dimension_2d == 8192);
  CHECK(std::get<Profile>(p).lower == "fragment");
  CHECK(std::get<Profile>(p).max_per_stage_descriptor_input_attachments == 4);
  CHECK(std::get<Profile>(p).costs.subpass_ns == 0.5);
}

TEST_CASE("a wrong profile is told by field") {
  CHECK(contains(problem(parse_profile("[]", "x.json")), "not a JSON object"));
  CHECK(contains(problem(parse_profile("{", "x.json")), "not a JSON object"));
  CHECK(contains(problem(parse_profile(with(kSound, R"("max_color_attachments": 4,)", ""), "x.json")),
                 "'max_color_attachments' is missing"));
  CHECK(contains(problem(parse_profile(with(kSound, ": 8192", ": -1"), "x.json")),
                 "'max_image_dimension_2d' should be a whole number"));
  CHECK(contains(problem(parse_profile(with(kSound, ": 8192", ": 4294967296"), "x.json")), "too large"));
  CHECK(contains(problem(parse_profile(with(kSound, "\"fragment\"", "\"geometry\""), "x.json")), "found \"geometry\""));
  CHECK(contains(problem(parse_profile(with(kSound, "\"raster\"", "\"rastr\""), "x.json")), "'raster' is missing"));
  CHECK(contains(problem(parse_profile(with(kSound, "\"name\"", "\"limits\": 1, \"name\""), "x.json")),
                 "unknown field 'limits'"));
  CHECK(
      contains(problem(parse_profile(with(kSound, R"("pass_ns": 1, )", ""), "x.json")), "'costs.pass_ns' is missing"));
  CHECK(contains(problem(parse_profile(with(kSound, R"("pass_ns": 1)", R"("pass_ns": 0)"), "x.json")),
                 "'costs.pass_ns' should be greater than 0"));
  CHECK(contains(problem(parse_profile(with(kSound, R"("pass_ns": 1)", R"("pass_ns": "1")"), "x.json")),
                 "'costs.pass_ns' should be a number"));
  CHECK(contains(problem(parse_profile(with(kSound, "subpass_ns", "subpas_ns"), "x.json")),
                 "'costs.subpass_ns' is missing"));
  CHECK(contains(problem(parse_profile(with(kSound, R"("costs": {)", R"("costs": {"fast": 1, )"), "x.json")),
                 "unknown field 'costs.fast'"));
  CHECK(contains(problem(parse_profile(
                     with(with(kSound, R"("costs": {)", R"("costs": [{)"), "}, \"lower\"", "}], \"lower\""), "x.json")),
                 "'costs' should be an object"));
}

// The parts of `vulkaninfo --json` that matter, as it writes them.
const char* const kReport = R"({
  "$schema": "https://schema.khronos.org/vulkan/profiles-0.8-latest.json",
  "capabilities": {"device": {
    "extensions": {"VK_KHR_multiview": 1},
    "features": {
      "VkPhysicalDeviceFeatures": {"shaderInt64": true, "fragmentStoresAndAtomics": true, "geometryShader": false},
      "VkPhysicalDeviceVulkan12Features": {"shaderBufferInt64Atomics": true}},
    "properties": {
      "VkPhysicalDeviceProperties": {
        "deviceName": "A card", "deviceType": "VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU",
        "limits": {"maxColorAttachments": 8, "maxPerStageDescriptorStorageBuffers": 31,
          "maxPerStageDescriptorSampledImages": 32, "maxPerStageDescriptorInputAttachments": 7,
          "maxPerStageResources": 128, "maxFragmentCombinedOutputResources": 16, "maxPushConstantsSize": 128,
          "maxImageDimension2D": 16384, "maxComputeWorkGroupInvocations": 256,
          "maxComputeWorkGroupCount": [65535, 65534, 65533], "maxComputeSharedMemorySize": 32768,
          "maxStorageBufferRange": 1073741824}},
      "VkPhysicalDeviceVulkan11Properties": {"subgroupSize": 16,
        "subgroupSupportedOperations": ["VK_SUBGROUP_FEATURE_BALLOT_BIT", "VK_SUBGROUP_FEATURE_ARITHMETIC_BIT"],
        "maxMultiviewViewCount": 6}}}},
  "profiles": {}
})";

TEST_CASE("a device report gives limits and features, and costs by type") {
  const auto result = parse_profile(kReport, "card.json");
  INFO(problem(result));
  REQUIRE(std::holds_alternative<Profile>(result));
  const Profile& p = std::get<Profile>(result);
  CHECK(p.name == "A card");
  CHECK(p.max_per_stage_descriptor_storage_buffers == 31);
  CHECK(p.max_per_stage_descriptor_input_attachments == 7);
  CHECK(p.max_compute_work_group_count_x == 65535);
  CHECK(p.max_storage_buffer_range == 1073741824);
  CHECK(p.subgroup_size == 16);
  CHECK(p.max_multiview_view_count == 6);
  CHECK(p.subgroup_arithmetic);
  const char* const kOperations = R"(["VK_SUBGROUP_FEATURE_BALLOT_BIT", "VK_SUBGROUP_FEATURE_ARITHMETIC_BIT"])";
  CHECK(std::get<Profile>(parse_profile(with(kReport, kOperations, "15"), "card.json")).subgroup_arithmetic);
  CHECK_FALSE(std::get<Profile>(parse_profile(with(kReport, kOperations, "9"), "card.json")).subgroup_arithmetic);
  CHECK_FALSE(p.subgroup_shuffle);
  CHECK(std::get<Profile>(parse_profile(with(kReport, kOperations, "31"), "card.json")).subgroup_shuffle);
  CHECK(contains(problem(parse_profile(with(kReport, kOperations, "true"), "card.json")),
                 "'subgroupSupportedOperations' should be a list of flags"));
  CHECK(p.shader_int64);
  CHECK(p.shader_buffer_int64_atomics);
  CHECK_FALSE(p.geometry_shader);
  CHECK_FALSE(p.shader_buffer_float32_atomic_add);
  const Profile integrated = std::get<Profile>(load_profile("intel-uhd620"));
  CHECK(p.costs.pass_ns == integrated.costs.pass_ns);
  CHECK(p.lower == integrated.lower);
  const Profile cpu =
      std::get<Profile>(parse_profile(with(kReport, "\"VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU\"", "4"), "card.json"));
  CHECK(cpu.costs.pass_ns == std::get<Profile>(load_profile("lavapipe")).costs.pass_ns);
}

TEST_CASE("the older form of a report has its structures at the top") {
  std::string text = with(kReport, R"("$schema": "https://schema.khronos.org/vulkan/profiles-0.8-latest.json",)", "");
  text = with(text, R"("capabilities": {"device": {)", "");
  text = with(text, R"("extensions": {"VK_KHR_multiview": 1},)", "");
  text = with(text, R"("features": {)", "");
  text = with(text, R"("shaderBufferInt64Atomics": true}})", R"("shaderBufferInt64Atomics": true})");
  text = with(text, R"("properties": {)", "");
  text = with(text, R"("maxMultiviewViewCount": 6}}}})", R"("maxMultiviewViewCount": 6})");
  const auto result = parse_profile(text, "card.json");
  INFO(problem(result));
  REQUIRE(std::holds_alternative<Profile>(result));
  CHECK(std::get<Profile>(result).max_per_stage_descriptor_input_attachments == 7);
}

TEST_CASE("a wrong device report is told by field") {
  CHECK(contains(problem(parse_profile(with(kReport, R"("maxPushConstantsSize": 128,)", ""), "card.json")),
                 "'maxPushConstantsSize' is missing"));
  CHECK(contains(problem(parse_profile(with(kReport, ": 16384", ": \"wide\""), "card.json")),
                 "'maxImageDimension2D' should be a whole number"));
  CHECK(contains(problem(parse_profile(with(kReport, ": 16384", ": 1e300"), "card.json")),
                 "'maxImageDimension2D' should be a whole number"));
  CHECK(contains(problem(parse_profile(
                     with(kReport, "\"maxColorAttachments\": 8", "\"maxColorAttachments\": 99999999999"), "card.json")),
                 "'maxColorAttachments' is too large"));
  CHECK(contains(
      problem(parse_profile(with(kReport, "\"geometryShader\": false", "\"geometryShader\": \"no\""), "card.json")),
      "'geometryShader' should be true or false"));
  CHECK(contains(problem(parse_profile(with(kReport, "\"VkPhysicalDeviceProperties\"", "\"VkPhysical\""), "card.json")),
                 "without 'VkPhysicalDeviceProperties'"));
  CHECK(
      contains(problem(parse_profile(R"({"capabilities": []})", "card.json")), "without 'VkPhysicalDeviceProperties'"));
}

TEST_CASE("a misspelled built-in name is corrected") {
  CHECK(contains(problem(load_profile("lavapip")), "'lavapipe'"));
  CHECK(contains(problem(load_profile("no/such/file.json")), "cannot read"));
}
