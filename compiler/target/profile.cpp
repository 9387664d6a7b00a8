// SPDX-License-Identifier: Apache-2.0
// Reading device profiles.
#include "compiler/target/profile.h"

#include <algorithm>
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>
#include <sstream>

#include "compiler/target/builtin_profiles.h"
#include "dsl/diagnostic.h"

namespace dr::target {

std::vector<std::string> builtin_profiles() {
  std::vector<std::string> names;
  for (const auto& [name, text] : kBuiltinProfiles) names.emplace_back(name);
  std::sort(names.begin(), names.end());
  return names;
}

std::variant<Profile, std::string> load_profile(std::string_view name) {
  for (const auto& [builtin, text] : kBuiltinProfiles)
    if (builtin == name) return parse_profile(text, name);
  if (name.find_first_of("./") == std::string_view::npos) {
    std::string message = "no profile named '" + std::string(name) + "'";
    if (auto near = dsl::nearest_name(name, builtin_profiles())) return message + "; did you mean '" + *near + "'?";
    message += "; there are";
    for (const std::string& n : builtin_profiles()) message += " " + n;
    return message;
  }
  std::ifstream file{std::string(name), std::ios::binary};
  if (!file) return "cannot read profile '" + std::string(name) + "'";
  std::stringstream text;
  text << file.rdbuf();
  return parse_profile(text.str(), name);
}

std::variant<Profile, std::string> parse_profile(std::string_view json, std::string_view origin) {
  const std::string where = "profile '" + std::string(origin) + "': ";
  const nlohmann::json root = nlohmann::json::parse(json, nullptr, false);
  if (!root.is_object()) return where + "not a JSON object";
  Profile p;
  std::string problem;
  std::set<std::string> known;
  auto field = [&](const char* name, auto& out) {
    known.insert(name);
    using T = std::decay_t<decltype(out)>;
    const auto it = root.find(name);
    if (it == root.end()) {
      if (problem.empty()) problem = where + "field '" + name + "' is missing";
      return;
    }
    constexpr bool boolean = std::is_same_v<T, bool>, text = std::is_same_v<T, std::string>;
    const bool fits = boolean ? it->is_boolean() : text ? it->is_string() : it->is_number_unsigned();
    if (!fits) {
      if (problem.empty())
        problem = where + "field '" + name + "' should be " +
                  (boolean ? "true or false"
                   : text  ? "a string"
                           : "a whole number");
      return;
    }
    if constexpr (!boolean && !text) {
      const auto value = it->template get<uint64_t>();
      if (value > std::numeric_limits<T>::max()) {
        if (problem.empty()) problem = where + "field '" + name + "' is too large";
        return;
      }
      out = static_cast<T>(value);
    } else {
      out = it->template get<T>();
    }
  };
  field("name", p.name);
  field("description", p.description);
  field("max_color_attachments", p.max_color_attachments);
  field("max_per_stage_descriptor_storage_buffers", p.max_per_stage_descriptor_storage_buffers);
  field("max_per_stage_descriptor_sampled_images", p.max_per_stage_descriptor_sampled_images);
  field("max_per_stage_resources", p.max_per_stage_resources);
  field("max_fragment_combined_output_resources", p.max_fragment_combined_output_resources);
  field("max_push_constants_size", p.max_push_constants_size);
  field("max_image_dimension_2d", p.max_image_dimension_2d);
  field("max_compute_work_group_invocations", p.max_compute_work_group_invocations);
  field("max_storage_buffer_range", p.max_storage_buffer_range);
  field("shader_int64", p.shader_int64);
  field("shader_buffer_int64_atomics", p.shader_buffer_int64_atomics);
  field("fragment_stores_and_atomics", p.fragment_stores_and_atomics);
  field("lower", p.lower);
  field("raster", p.raster);
  if (!problem.empty()) return problem;
  for (const auto& [key, value] : root.items())
    if (known.count(key) == 0) {
      const auto near = dsl::nearest_name(key, {known.begin(), known.end()});
      return where + "unknown field '" + key + "'" + (near ? "; did you mean '" + *near + "'?" : "");
    }
  if (p.lower != "fragment" && p.lower != "compute")
    return where + "field 'lower' should be \"fragment\" or \"compute\", found \"" + p.lower + "\"";
  if (p.raster != "hardware" && p.raster != "compute")
    return where + "field 'raster' should be \"hardware\" or \"compute\", found \"" + p.raster + "\"";
  return p;
}

}  // namespace dr::target
