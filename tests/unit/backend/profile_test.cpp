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
  "max_per_stage_descriptor_sampled_images": 16, "max_per_stage_resources": 44, "max_fragment_combined_output_resources": 8,
  "max_push_constants_size": 128, "max_image_dimension_2d": 8192, "max_compute_work_group_invocations": 128,
  "max_storage_buffer_range": 134217728, "shader_int64": false, "shader_buffer_int64_atomics": false,
  "fragment_stores_and_atomics": true, "lower": "fragment", "raster": "hardware"})";

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
}

TEST_CASE("a misspelled built-in name is corrected") {
  CHECK(contains(problem(load_profile("lavapip")), "'lavapipe'"));
  CHECK(contains(problem(load_profile("no/such/file.json")), "cannot read"));
}
