// SPDX-License-Identifier: Apache-2.0
// What a SPIR-V module asks of whoever runs it, as far as the runtime gives it: no more of SPIR-V than that.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <variant>
#include <vector>

#include "bundle_generated.h"

namespace dr::bundle {

// A variable that a descriptor stands behind.
struct ReflectedResource {
  enum class Kind : uint8_t { Buffer, Texels, Image, Input };
  Kind kind = Kind::Buffer;
  uint32_t set = 0, binding = 0;
  bool read_only = false;         // of a buffer
  Scalar scalar = Scalar::Float;  // of texels
  uint32_t input = 0;             // number of the input attachment
};

// What one stage gives to the next, or to an attachment.
struct ReflectedPort {
  uint32_t location = 0;
  Scalar scalar = Scalar::Float;
  uint32_t components = 1;
};

// A number, or the specialization constant of that number.
struct ReflectedSize {
  bool is_constant = false;
  uint32_t number = 1;
};

struct Reflection {
  Stage stage = Stage::Compute;
  std::vector<uint32_t> capabilities;
  std::vector<ReflectedResource> resources;
  std::vector<ReflectedPort> inputs, outputs;
  std::vector<uint32_t> constants;  // numbers of specialization constants
  uint32_t push_bytes = 0;
  std::array<ReflectedSize, 3> group;  // invocations of a workgroup
  uint64_t shared_bytes = 0;           // of a workgroup
};

// Of a valid module, or one sentence on what the runtime does not give. Of an invalid one anything, but no crash.
std::variant<Reflection, std::string> reflect(std::span<const uint32_t> module);

}  // namespace dr::bundle
