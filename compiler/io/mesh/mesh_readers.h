// SPDX-License-Identifier: Apache-2.0
// The mesh formats behind load_mesh and load_binding. Private to compiler/io; every function throws Failure.
#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "compiler/io/file/file.h"
#include "compiler/io/mesh/mesh.h"

namespace dr::io {

enum class MeshAttribute {
  Position,
  Indices,
  Uv,
  UvIndices,
  Normal,
  Color,
  // glTF only.
  Uv1,
  Tangent,
  Joints,
  Weights,
  Material,
  MorphPosition,
  MorphNormal
};

// What a reader must find. An attribute that is asked for by name and is missing is an error that says where; without
// one, missing attributes are left empty.
using RequiredAttribute = std::optional<MeshAttribute>;

Mesh parse_obj(std::string_view text, RequiredAttribute required);

// `path` tells where buffers may lie; the content is either form of glTF.
Mesh parse_gltf(std::span<const uint8_t> content, const std::string& path, RequiredAttribute required);

// Reads a file of either format.
Mesh read_mesh(const std::string& path, RequiredAttribute required);

}  // namespace dr::io
