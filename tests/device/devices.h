// SPDX-License-Identifier: Apache-2.0
// The software devices that device tests run on.
#pragma once

#include <string>
#include <vector>

#include "runtime/runtime.h"
#include "tests/catch.h"

namespace dr::test {

struct NamedDevice {
  std::string name;  // "lavapipe" or "swiftshader", also its profile's name
  runtime::Device device;
};

// The devices that the environment names (DR_LAVAPIPE_ICD, DR_SWIFTSHADER_ICD), opened under validation. Where CI is
// set in the environment both must be there; elsewhere a missing one is told on stdout. DR_TEST_DEVICE adds one by name
// or index, without validation: a GPU, by hand.
std::vector<NamedDevice> devices();

// The path of a profile, which is there until the process ends, of a device for which subpasses cost next to nothing,
// so that packing makes them.
std::string profile_of_subpasses(const std::string& device);

// What a call gives; its error fails the test.
template <class T>
T must(io::Result<T> result) {
  if (!result) FAIL(result.error());
  if constexpr (!std::is_void_v<T>) return std::move(result).value();
}

}  // namespace dr::test
