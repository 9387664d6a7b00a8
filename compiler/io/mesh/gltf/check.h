// SPDX-License-Identifier: Apache-2.0
// What a glTF file's JSON must be before tinygltf sees it. tinygltf takes a field of a wrong type for an absent one,
// drops primitives and channels that it cannot parse, and reads images at offsets that it does not check; here each
// field that the readers use, in every object of the file, is an error with its full name, or is right. Fields without
// a meaning here are let pass, as the format asks for. Private to compiler/io; every function throws Failure.
#pragma once

#include "compiler/io/mesh/gltf/container.h"

namespace dr::io::gltf {

// The most of each kind of object that a file may hold: nodes cost most, about a kilobyte.
inline constexpr uint64_t kMaxNodes = uint64_t{1} << 20;

enum ComponentType : uint64_t {
  kByte = 5120,
  kUByte = 5121,
  kShort = 5122,
  kUShort = 5123,
  kUInt = 5125,
  kFloat = 5126
};
enum Mode : uint64_t { kTriangles = 4, kStrip = 5, kFan = 6 };

// Checks all of it. Whole numbers that are written as 3.0 become 3.
void check_document(Json& root);

}  // namespace dr::io::gltf
