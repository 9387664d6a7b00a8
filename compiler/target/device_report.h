// SPDX-License-Identifier: Apache-2.0
// Profiles from what tools report of a device: the JSON of `vulkaninfo --json` and of Vulkan profiles (VkConfig,
// gpuinfo.org), in which `capabilities` hold structures of features and properties, and the older form of vulkaninfo,
// which has the structures at the top.
//   vulkaninfo --json=0 -o device.json  &&  drc build --profile device.json ...
// Reports say nothing of costs: those are typical ones of the device's type (CPU, integrated, discrete).
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <variant>

#include "compiler/target/profile.h"

namespace dr::target {

// Whether a JSON object is such a report, sound or not.
bool is_device_report(const nlohmann::json& root);

// Requires is_device_report(). The error names the missing or wrong field.
std::variant<Profile, std::string> profile_from_report(const nlohmann::json& root);

}  // namespace dr::target
