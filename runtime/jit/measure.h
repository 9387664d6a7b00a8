// SPDX-License-Identifier: Apache-2.0
// A device's own profile: its limits, and what things cost on it, measured in a few seconds.
#pragma once

#include <string>

#include "compiler/io/file/result.h"
#include "runtime/runtime.h"

namespace dr::jit {

// The profile as JSON, as drc's --profile takes it.
io::Result<std::string> measure_profile(const runtime::Device& device);

}  // namespace dr::jit
