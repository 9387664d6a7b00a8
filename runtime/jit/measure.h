// SPDX-License-Identifier: Apache-2.0
// A device's own profile: its limits, and what things cost on it, measured in a few seconds.
#pragma once

#include <cstdint>
#include <string>

#include "compiler/io/file/result.h"
#include "runtime/runtime.h"

namespace dr::jit {

// The profile as JSON, as drc's --profile takes it.
io::Result<std::string> measure_profile(const runtime::Device& device);

// The least that a command of a device can take, as its profile has it: 0 where that says nothing.
struct Floor {
  double command_ns = 0, bytes_per_ns = 0;
};
Floor floor_of(const std::string& profile);

// How many trips the loops of an invocation take before the driver ends them; 0: no end was found within 2^20.
io::Result<uint32_t> measure_loop_trips(const runtime::Device& device);

}  // namespace dr::jit
