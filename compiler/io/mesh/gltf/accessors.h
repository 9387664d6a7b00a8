// SPDX-License-Identifier: Apache-2.0
// Accessors: where elements lie in buffer views, with strides, sparse substitution and normalized integers. Private to
// compiler/io; every function throws Failure.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "compiler/io/mesh/gltf/check.h"
#include "compiler/io/mesh/gltf/document.h"

namespace dr::io::gltf {

// An accessor's elements without gaps, sparse substitution done.
struct Elements {
  std::vector<uint8_t> bytes;
  uint64_t count = 0;
  uint64_t components = 1;
  uint64_t component_type = kFloat;
  bool normalized = false;
};

// `limit` bounds the count.
Elements read_elements(const Document& document, uint64_t index, uint64_t limit);

uint64_t unsigned_at(const Elements& elements, uint64_t i);

// A primitive's vertices in the order that its triangles or lines take them in.
std::vector<uint32_t> read_order(const Document& document, const tinygltf::Primitive& primitive, uint64_t vertex_count,
                                 const std::string& where);

// What an attribute may be made of.
enum class Integers {
  None,                // floats only
  NormalizedUnsigned,  // or normalized unsigned ones of 8 and 16 bits, as texture coordinates and colours may be
  Normalized,          // or signed ones, too, as animations may have
};
struct Expected {
  uint64_t least_components;
  uint64_t most_components;
  Integers integers = Integers::None;
  uint64_t count = 0;  // 0: any
};

// As floats, all of them finite. `where` names who refers to the accessor.
struct Floats {
  std::vector<float> values;
  uint64_t components = 1;
};
Floats read_floats(const Document& document, uint64_t index, const Expected& expected, uint64_t limit,
                   const std::string& where);

}  // namespace dr::io::gltf
