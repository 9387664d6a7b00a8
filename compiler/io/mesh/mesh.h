// SPDX-License-Identifier: Apache-2.0
// Triangle meshes from and to OBJ, glTF and GLB files, in the one form that programs use: flat arrays, 0-based indices,
// texture coordinates with their origin at the top left.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "compiler/io/array/array.h"
#include "compiler/io/file/result.h"

namespace dr::io {

// The most vertices (or texture coordinates, or normals of a file) and triangles that a mesh may have.
inline constexpr int64_t kMaxVertices = int64_t{1} << 24;
inline constexpr int64_t kMaxTriangles = int64_t{1} << 25;

// Positions and texture coordinates have index arrays of their own, so that a seam does not tear when positions move.
// Every number is finite and every index is in range.
struct Mesh {
  std::vector<float> positions;     // x y z of each vertex
  std::vector<int32_t> indices;     // three vertices of each triangle
  std::vector<float> uv;            // u v; v = 0 is the top row of the texture. Empty: the file has none
  std::vector<int32_t> uv_indices;  // three entries of `uv` of each triangle. Empty: `uv` is
  std::vector<float> normals;       // x y z of each vertex, unit length. Empty: the file has none
  std::vector<float> colors;        // r g b a of each vertex, as in the file. Empty: the file has none

  // What only glTF has. Empty: the file has none.
  std::vector<float> uv1;          // the second u v of each vertex
  std::vector<float> tangents;     // x y z of each vertex, unit length, and the sign of the bitangent
  std::vector<int32_t> joints;     // four joints of each vertex: places in the skins' lists, one skin after another
  std::vector<float> weights;      // and how much each of them counts
  std::vector<int32_t> materials;  // the material of each triangle; -1: none
  struct Morph {
    std::vector<float> positions;  // what is added to each vertex, x y z
    std::vector<float> normals;    // empty: no primitive has them
  };
  std::vector<Morph> morphs;

  int64_t vertex_count() const { return static_cast<int64_t>(positions.size() / 3); }
  int64_t triangle_count() const { return static_cast<int64_t>(indices.size() / 3); }
};

// Reads a triangle mesh by content (GLB) and extension (.obj, .gltf, .glb). What is optional is left empty unless the
// whole file has it.
//
// OBJ: positions stay in the file's order; polygons become fans; `vt` becomes (u, 1 - v); a vertex whose corners name
// several normals gets their mean. `v x y z r g b` gives colours. Groups, materials, lines and points are passed over,
// free-form surfaces and misspelled statements are errors.
//
// glTF: every primitive of every node of the default scene, one after another, with the nodes' transforms applied (and
// the winding swapped under a mirroring one); `uv` is TEXCOORD_0 and shares `indices`; `colors` is COLOR_0, in which a
// missing alpha is 1. A vertex of a skinned node stays where the skin's joints expect it: the format says that their
// matrices alone place it. Morph targets are not added; images are not opened. Buffers are embedded or lie in the
// folder of the file; nothing outside it is read. Cameras, lights, materials and the rest are in
// compiler/io/mesh/scene.h.
Result<Mesh> load_mesh(const std::string& path);

// The material that glTF files are written with; it owns nothing.
struct MaterialView {
  std::array<double, 4> base_color = {1, 1, 1, 1};  // linear, times the texture; all factors are in [0, 1]
  double metallic = 0;
  double roughness = 1;
  std::array<double, 3> emissive = {0, 0, 0};
  // Pictures of numbers, 3 components, one layer; they need `uv`.
  const Array* metallic_roughness = nullptr;  // roughness in the second component, metallic in the third
  const Array* normal = nullptr;              // x y z of tangent space, as n / 2 + 0.5
  const Array* occlusion = nullptr;           // in the first component
  const Array* emission = nullptr;            // a colour: linear, times `emissive`
};

// What save_mesh writes; it owns nothing.
struct MeshView {
  std::span<const float> positions;
  std::span<const int32_t> indices;
  std::span<const float> uv = {};
  std::span<const int32_t> uv_indices = {};  // empty with a `uv`: it shares `indices`
  std::span<const float> normals = {};       // one per vertex; empty: smooth ones are computed
  const Array* texture = nullptr;            // base colour: linear, 3 or 4 components, one layer; needs `uv`
  MaterialView material = {};                // glTF only

  // What a view has no place for is left out: colours, the second uv, tangents, joints, weights, materials and morph
  // targets. Precondition: the mesh outlives the view.
  static MeshView of(const Mesh& mesh) {
    return {.positions = mesh.positions,
            .indices = mesh.indices,
            .uv = mesh.uv,
            .uv_indices = mesh.uv_indices,
            .normals = mesh.normals};
  }
};

// Writes a mesh, whole or not at all, by extension. Positions, uv and indices read back as they were, and so do normals
// of unit length; others are written at unit length.
//   .obj   the texture goes to NAME.mtl and NAME_texture.png beside it
//   .gltf  one file, with buffer and texture embedded as text
//   .glb   one file, with buffer and texture embedded
// In glTF a vertex has one texture coordinate: vertex i keeps its place with the first one it is used with, and a copy
// for each further one is appended; those that no corner uses are left out. In OBJ a normal is that of a corner: the
// vertices that no triangle uses read back with (0, 0, 1).
Result<void> save_mesh(const std::string& path, const MeshView& mesh);
// Whether an OBJ file of this name can name its material's file.
Result<void> check_material_file(const std::string& path);

// Unit normals of the vertices, weighted by area; (0, 0, 1) where there is no face or no area.
// Precondition: indices in range, three per triangle.
std::vector<float> smooth_normals(std::span<const float> positions, std::span<const int32_t> indices);

}  // namespace dr::io
