// SPDX-License-Identifier: Apache-2.0
// One mesh and its material as a glTF file, through tinygltf. Private to compiler/io; every function throws Failure.
#pragma once

#include <cstdint>
#include <vector>

#include "compiler/io/file/file.h"
#include "compiler/io/mesh/mesh.h"

namespace dr::io::gltf {

// A mesh with one texture coordinate a vertex.
struct WeldedMesh {
  std::vector<float> positions;
  std::vector<float> normals;
  std::vector<float> uv;
  std::vector<uint32_t> indices;
};

// `binary`: .glb, else .gltf with all of it embedded as text.
Bytes write(const WeldedMesh& mesh, const Array* texture, const MaterialView& material, bool binary);

}  // namespace dr::io::gltf
