// SPDX-License-Identifier: Apache-2.0
#include "runtime/program/check_trips.h"

#include <algorithm>

#include "compiler/target/profile.h"

namespace dr::runtime {

namespace {

bool has_loops(const std::vector<uint32_t>& spirv) {
  constexpr uint32_t kLoopMerge = 246, kHeader = 5;
  for (size_t at = kHeader; at < spirv.size(); at += std::max(spirv[at] >> 16, 1u))
    if ((spirv[at] & 0xffffu) == kLoopMerge) return true;
  return false;
}

// 0 for none, and for profiles that are not built in.
uint32_t trips_of_profile(const std::string& name) {
  const std::vector<std::string> all = target::builtin_profiles();
  if (std::ranges::find(all, name) == all.end()) return 0;
  return std::get<target::Profile>(target::load_profile(name)).loop_trips;
}

}  // namespace

std::optional<std::string> check_trips(const bundle::BundleT& bundle, const std::string& device_profile) {
  if (bundle.profile == device_profile) return std::nullopt;  // it says what it knows of this device
  const uint32_t limit = trips_of_profile(device_profile);
  if (limit == 0 || (bundle.loop_trips > 0 && bundle.loop_trips <= limit)) return std::nullopt;
  if (std::ranges::none_of(bundle.shaders, [](const auto& s) { return has_loops(s->spirv); })) return std::nullopt;
  return "the bundle was built for profile '" + bundle.profile + "', whose devices let loops " +
         (bundle.loop_trips == 0 ? "run on" : "take " + std::to_string(bundle.loop_trips) + " trips") +
         "; this device ends them after " + std::to_string(limit) + " trips: build it with --profile=" + device_profile;
}

}  // namespace dr::runtime
