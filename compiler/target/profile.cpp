// SPDX-License-Identifier: Apache-2.0
// Reading device profiles.
#include "compiler/target/profile.h"

#include <algorithm>
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>

#include "compiler/target/builtin_profiles.h"
#include "compiler/target/device_report.h"
#include "dsl/diagnostic/diagnostic.h"

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
  constexpr size_t kMost = 1 << 20;  // bytes
  std::ifstream file{std::string(name), std::ios::binary};
  std::string text(kMost + 1, '\0');
  if (file) file.read(text.data(), static_cast<std::streamsize>(text.size()));
  if (file.bad() || (file.fail() && !file.eof())) return "cannot read profile '" + std::string(name) + "'";
  text.resize(static_cast<size_t>(file.gcount()));
  if (text.size() > kMost) return "'" + std::string(name) + "' is larger than a profile";
  return parse_profile(text, name);
}

namespace {

// Takes the fields of one JSON object, each of which must be there; the first problem is kept.
class Fields {
 public:
  Fields(const nlohmann::json& object, std::string prefix) : object_(object), prefix_(std::move(prefix)) {}

  template <class T>
  void take(const char* name, T& out) {
    constexpr bool boolean = std::is_same_v<T, bool>, text = std::is_same_v<T, std::string>,
                   real = std::is_same_v<T, double>;
    const nlohmann::json* value = find(name);
    if (value == nullptr) return;
    const bool fits = boolean ? value->is_boolean()
                      : text  ? value->is_string()
                      : real  ? value->is_number()
                              : value->is_number_unsigned();
    if (!fits)
      return fail(name, std::string("should be ") + (boolean ? "true or false"
                                                     : text  ? "a string"
                                                     : real  ? "a number"
                                                             : "a whole number"));
    if constexpr (real) {
      out = value->template get<double>();
      if (out <= 0) fail(name, "should be greater than 0");
    } else if constexpr (boolean || text) {
      out = value->template get<T>();
    } else {
      const auto number = value->template get<uint64_t>();
      if (number > std::numeric_limits<T>::max()) return fail(name, "is too large");
      out = static_cast<T>(number);
    }
  }
  const nlohmann::json* find(const char* name) {
    known_.insert(name);
    const auto it = object_.find(name);
    if (it != object_.end()) return &*it;
    fail(name, "is missing");
    return nullptr;
  }
  void fail(const char* name, const std::string& what) {
    if (problem_.empty()) problem_ = "field '" + prefix_ + name + "' " + what;
  }
  // The first problem, or a field that nobody took.
  std::string problem() const {
    if (!problem_.empty()) return problem_;
    for (const auto& [key, value] : object_.items())
      if (known_.count(key) == 0) {
        const auto near = dsl::nearest_name(key, {known_.begin(), known_.end()});
        return "unknown field '" + prefix_ + key + "'" + (near ? "; did you mean '" + *near + "'?" : "");
      }
    return "";
  }

 private:
  const nlohmann::json& object_;
  std::string prefix_, problem_;
  std::set<std::string> known_;
};

// Every field by its name in the file.
template <class P, class F>
void visit_fields(P& p, const F& f) {
  f("name", p.name);
  f("description", p.description);
  f("max_color_attachments", p.max_color_attachments);
  f("max_per_stage_descriptor_storage_buffers", p.max_per_stage_descriptor_storage_buffers);
  f("max_per_stage_descriptor_sampled_images", p.max_per_stage_descriptor_sampled_images);
  f("max_per_stage_descriptor_input_attachments", p.max_per_stage_descriptor_input_attachments);
  f("max_per_stage_resources", p.max_per_stage_resources);
  f("max_fragment_combined_output_resources", p.max_fragment_combined_output_resources);
  f("max_push_constants_size", p.max_push_constants_size);
  f("max_image_dimension_2d", p.max_image_dimension_2d);
  f("max_compute_work_group_invocations", p.max_compute_work_group_invocations);
  f("max_compute_work_group_count_x", p.max_compute_work_group_count_x);
  f("max_compute_shared_memory_size", p.max_compute_shared_memory_size);
  f("max_multiview_view_count", p.max_multiview_view_count);
  f("subgroup_size", p.subgroup_size);
  f("max_storage_buffer_range", p.max_storage_buffer_range);
  f("loop_trips", p.loop_trips);
  f("subgroup_arithmetic", p.subgroup_arithmetic);
  f("subgroup_shuffle", p.subgroup_shuffle);
  f("lanes_in_turn", p.lanes_in_turn);
  f("else_doubles_compile", p.else_doubles_compile);
  f("shader_int64", p.shader_int64);
  f("shader_buffer_int64_atomics", p.shader_buffer_int64_atomics);
  f("shader_buffer_float32_atomic_add", p.shader_buffer_float32_atomic_add);
  f("fragment_stores_and_atomics", p.fragment_stores_and_atomics);
  f("geometry_shader", p.geometry_shader);
  f("lower", p.lower);
  f("raster", p.raster);
}
template <class C, class F>
void visit_costs(C& c, const F& f) {
  f("pass_ns", c.pass_ns);
  f("subpass_ns", c.subpass_ns);
  f("dispatch_ns", c.dispatch_ns);
  f("fragment_image_bytes_per_ns", c.fragment_image_bytes_per_ns);
  f("fragment_input_bytes_per_ns", c.fragment_input_bytes_per_ns);
  f("fragment_buffer_bytes_per_ns", c.fragment_buffer_bytes_per_ns);
  f("compute_image_bytes_per_ns", c.compute_image_bytes_per_ns);
  f("compute_buffer_bytes_per_ns", c.compute_buffer_bytes_per_ns);
  f("fragment_operations_per_ns", c.fragment_operations_per_ns);
  f("compute_operations_per_ns", c.compute_operations_per_ns);
  f("atomic_add_ns", c.atomic_add_ns);
  f("hardware_triangle_ns", c.hardware_triangle_ns);
  f("hardware_pixel_ns", c.hardware_pixel_ns);
  f("compute_triangle_ns", c.compute_triangle_ns);
  f("compute_pixel_ns", c.compute_pixel_ns);
  f("fragment_compile_ms", c.fragment_compile_ms);
  f("compute_compile_ms", c.compute_compile_ms);
}

std::string take_costs(const nlohmann::json& object, Costs& c) {
  if (!object.is_object()) return "field 'costs' should be an object";
  Fields f(object, "costs.");
  visit_costs(c, [&](const char* name, double& out) { f.take(name, out); });
  return f.problem();
}

}  // namespace

std::variant<Profile, std::string> parse_profile(std::string_view json, std::string_view origin) {
  const std::string where = "profile '" + std::string(origin) + "': ";
  const nlohmann::json root = nlohmann::json::parse(json, nullptr, false);
  if (!root.is_object()) return where + "not a JSON object";
  if (is_device_report(root)) {
    auto from_report = profile_from_report(root);
    if (const auto* problem = std::get_if<std::string>(&from_report)) return where + *problem;
    return from_report;
  }
  Profile p;
  Fields f(root, "");
  visit_fields(p, [&](const char* name, auto& out) { f.take(name, out); });
  const nlohmann::json* costs = f.find("costs");
  if (std::string problem = f.problem(); !problem.empty()) return where + problem;
  if (std::string problem = take_costs(*costs, p.costs); !problem.empty()) return where + problem;
  if (p.lower != "fragment" && p.lower != "compute")
    return where + "field 'lower' should be \"fragment\" or \"compute\", found \"" + p.lower + "\"";
  if (p.raster != "hardware" && p.raster != "compute")
    return where + "field 'raster' should be \"hardware\" or \"compute\", found \"" + p.raster + "\"";
  return p;
}

std::string write_profile(const Profile& p) {
  nlohmann::ordered_json root;
  visit_fields(p, [&](const char* name, const auto& value) { root[name] = value; });
  visit_costs(p.costs, [&](const char* name, double value) { root["costs"][name] = value; });
  return root.dump(2) + "\n";
}

}  // namespace dr::target
