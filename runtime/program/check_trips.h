// SPDX-License-Identifier: Apache-2.0
// Whether a device ends loops that the profile of a bundle lets run.
#pragma once

#include <optional>
#include <string>

#include "compiler/backend/bundle/bundle.h"

namespace dr::runtime {

// A bundle that was built for a built-in profile without a limit of trips, and whose shaders have loops, is refused
// where the device's own profile has one: a sentence, or nothing. What a profile of the user's says is taken for true.
std::optional<std::string> check_trips(const bundle::BundleT& bundle, const std::string& device_profile);

}  // namespace dr::runtime
