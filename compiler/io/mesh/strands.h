// SPDX-License-Identifier: Apache-2.0
// Strands of hair from TressFX files (.tfx, versions 3 and 4) and Cem Yuksel's (.hair). Private to compiler/io; every
// function throws Failure.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "compiler/io/array/array.h"

namespace dr::io {

// Polylines, one after another, each of two vertices or more. Every number is finite.
struct Strands {
  std::vector<float> positions;   // x y z of each vertex
  std::vector<int32_t> vertices;  // how many each strand has
  std::vector<float> widths;      // of each vertex. Empty: the file has none
  std::vector<float> opacities;   // of each vertex, 0 to 1. Empty: the file has none
  std::vector<float> colors;      // r g b of each vertex. Empty: the file has none
  std::vector<float> root_uv;     // u v of each strand. Empty: the file has none
};

// What is said of all strands alike, in the header of a .hair file, is given to each vertex.
Strands parse_tfx(std::span<const uint8_t> bytes);
Strands parse_hair(std::span<const uint8_t> bytes);

// What `--bind NAME=hair.tfx:SELECTOR` or `scene.gltf:lines:SELECTOR` gives; docs/reference/files.md lists the
// selectors.
Array bind_strands(const std::string& path, std::span<const std::string_view> selectors);

}  // namespace dr::io
