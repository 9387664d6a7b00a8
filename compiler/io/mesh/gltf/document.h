// SPDX-License-Identifier: Apache-2.0
// A glTF file as tinygltf's model, after the strict check: every index is in range, every buffer view lies in its
// buffer, nothing was dropped. Private to compiler/io; every function throws Failure.
#pragma once

#include <tiny_gltf.h>

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "compiler/io/file/file.h"
#include "compiler/io/mesh/scene.h"

namespace dr::io::gltf {

// The most bytes of all buffers of a file together.
inline constexpr uint64_t kMaxBufferBytes = uint64_t{1} << 30;

struct Document {
  tinygltf::Model model;
  std::vector<std::string> image_uris;  // as in the file; empty where the picture is a buffer view
  std::string path;                     // of the glTF file
  uint64_t buffer_bytes = 0;            // of all buffers
};

// `path` tells where buffers may lie.
Document load_document(std::span<const uint8_t> content, const std::string& path);

// All but the triangles and the pictures.
Scene read_scene(const Document& document);

// The encoded picture of images[index]: of a buffer view, embedded as text, or a file in the folder of the glTF file.
Bytes image_file(const Document& document, size_t index);

}  // namespace dr::io::gltf
