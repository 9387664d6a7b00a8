// SPDX-License-Identifier: Apache-2.0
// What check() does not know of a bundle: whether its shaders are valid, and ask for what its tables and the device
// give. For bundles from outside: drivers take valid shaders for granted, and crash where they are not.
#pragma once

#include <array>
#include <cstdint>
#include <string>

#include "compiler/backend/bundle/bundle.h"

namespace dr::bundle {

// Of a device, what shaders may use.
struct ShaderLimits {
  // Bytes that a workgroup shares.
  uint64_t shared_bytes = UINT64_MAX;
  uint32_t group_invocations = UINT32_MAX;
  bool int64 = true, int64_atomics = true, float_atomics = true, subgroups = true, shuffles = true, multiview = true;
};

// One sentence on what is wrong; empty when all is well. The bundle is sound.
std::string check_shaders(const BundleT& bundle, const ShaderLimits& limits);

}  // namespace dr::bundle
