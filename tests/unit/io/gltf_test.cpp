// SPDX-License-Identifier: Apache-2.0
// glTF and GLB: buffers, transforms, accessor forms, primitive modes.

#include <cmath>
#include <filesystem>

#include "compiler/io/mesh/mesh.h"
#include "tests/catch.h"
#include "tests/unit/io/support.h"

namespace dr::io {
namespace {

using namespace test;

const std::vector<float> kQuadPositions = {0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0};
const std::vector<float> kQuadUv = {0, 1, 1, 1, 1, 0, 0, 0};
const std::vector<int32_t> kQuadIndices = {0, 1, 2, 0, 2, 3};

void check_quad(const Mesh& mesh) {
  CHECK(mesh.positions == kQuadPositions);
  CHECK(mesh.uv == kQuadUv);
  CHECK(mesh.indices == kQuadIndices);
  CHECK(mesh.uv_indices == kQuadIndices);
  CHECK(mesh.normals.empty());
  CHECK(mesh.colors.empty());
}

TEST_CASE("buffers may be text, a chunk or a file", "[io][gltf]") {
  const TemporaryFolder folder;
  check_quad(load(folder.write("text.gltf", quad_gltf())));
  check_quad(load(folder.write("chunk.glb", quad_glb())));
  // The form is told by the content.
  check_quad(load(folder.write("chunk.gltf", quad_glb())));

  folder.write("parts/the quad.bin", quad_buffer() + "more");
  check_quad(load(folder.write("file.gltf", quad_json(R"(, "uri": "parts/the%20quad.bin")"))));
}

TEST_CASE("a file found from the current folder is found", "[io][gltf]") {
  const TemporaryFolder folder;
  folder.write("quad.bin", quad_buffer());
  folder.write("quad.gltf", quad_json(R"(, "uri": "quad.bin")"));
  const std::filesystem::path before = std::filesystem::current_path();
  std::filesystem::current_path(folder.path());
  const Result<Mesh> mesh = load_mesh("quad.gltf");
  std::filesystem::current_path(before);
  REQUIRE(mesh.ok());
  check_quad(*mesh);
}

TEST_CASE("transforms of nodes are applied from the root down", "[io][gltf]") {
  const TemporaryFolder folder;
  // Parent: a quarter turn about z. Child: scaled by 2, then moved by (10, 0, 0).
  const std::string json =
      replaced(quad_gltf(), R"("nodes": [{"mesh": 0}])",
               R"("nodes": [{"rotation": [0, 0, 0.7071067811865476, 0.7071067811865476], "children": [1]},
                   {"mesh": 0, "translation": [10, 0, 0], "scale": [2, 2, 2]}])");
  const Mesh mesh = load(folder.write("a.gltf", json));
  // (1, 1, 0) -> (12, 2, 0) -> (-2, 12, 0)
  CHECK(mesh.positions[6] == Approx(-2));
  CHECK(mesh.positions[7] == Approx(12));
  CHECK(mesh.indices == kQuadIndices);

  // The same as matrices, column after column.
  const std::string matrices =
      replaced(quad_gltf(), R"("nodes": [{"mesh": 0}])",
               R"("nodes": [{"matrix": [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1], "children": [1]},
                   {"mesh": 0, "matrix": [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 10, 0, 0, 1]}])");
  const Mesh same = load(folder.write("b.gltf", matrices));
  for (size_t i = 0; i < 12; ++i) CHECK(same.positions[i] == Approx(mesh.positions[i]).margin(1e-6));
}

TEST_CASE("a mirroring node swaps the winding", "[io][gltf]") {
  const TemporaryFolder folder;
  const Mesh mesh =
      load(folder.write("a.gltf", replaced(quad_gltf(), R"({"mesh": 0})", R"({"mesh": 0, "scale": [-1, 1, 1]})")));
  CHECK(mesh.positions[3] == -1);
  CHECK(mesh.indices == std::vector<int32_t>{0, 2, 1, 0, 3, 2});
}

TEST_CASE("every use of a mesh is merged, from the default scene only", "[io][gltf]") {
  const TemporaryFolder folder;
  std::string json = replaced(quad_gltf(), R"("nodes": [{"mesh": 0}])",
                              R"("nodes": [{"mesh": 0}, {"mesh": 0, "translation": [0, 0, 5]}, {"mesh": 0}])");
  json = replaced(json, R"("scene": 0, "scenes": [{"nodes": [0]}])",
                  R"("scene": 1, "scenes": [{"nodes": [0]}, {"nodes": [0, 1]}])");
  const Mesh mesh = load(folder.write("a.gltf", json));
  CHECK(mesh.vertex_count() == 8);
  CHECK(mesh.triangle_count() == 4);
  CHECK(mesh.positions[14] == 5);
  CHECK(mesh.indices[6] == 4);
  CHECK(mesh.uv.size() == 16);

  // Without scenes, the nodes that nothing refers to; without nodes, the meshes.
  const std::string no_scene = replaced(json, R"("scene": 1, "scenes": [{"nodes": [0]}, {"nodes": [0, 1]}],)", "");
  CHECK(load(folder.write("b.gltf", no_scene)).vertex_count() == 12);
  const std::string bare =
      replaced(quad_gltf(), R"("scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],)", "");
  check_quad(load(folder.write("c.gltf", bare)));
}

TEST_CASE("normals follow the inverse transpose", "[io][gltf]") {
  const TemporaryFolder folder;
  // A slope of 45 degrees under a scale of 2 in x: the normal (-1, 0, 1) becomes (-0.5, 0, 1).
  const std::string buffer = f32({0, 0, 0, 1, 0, 1, 0, 1, 0}) + f32({-0.70710678f, 0, 0.70710678f, -0.70710678f, 0,
                                                                     0.70710678f, -0.70710678f, 0, 0.70710678f});
  const auto file = [&](std::string_view scale) {
    return glb_file(R"({"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}],
      "nodes": [{"mesh": 0, "scale": )" +
                        std::string(scale) + R"(}],
      "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1}}]}],
      "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
                    {"bufferView": 0, "byteOffset": 36, "componentType": 5126, "count": 3, "type": "VEC3"}],
      "bufferViews": [{"buffer": 0, "byteLength": 72}], "buffers": [{"byteLength": 72}]})",
                    buffer);
  };
  const Mesh mesh = load(folder.write("a.glb", file("[2, 1, 1]")));
  CHECK(mesh.normals[0] == Approx(-1 / std::sqrt(5.0)));
  CHECK(mesh.normals[2] == Approx(2 / std::sqrt(5.0)));
  CHECK(mesh.indices == std::vector<int32_t>{0, 1, 2});
  // Mirrored in z, the normal is mirrored too.
  const Mesh mirrored = load(folder.write("b.glb", file("[2, 1, -1]")));
  CHECK(mirrored.normals[0] == Approx(-1 / std::sqrt(5.0)));
  CHECK(mirrored.normals[2] == Approx(-2 / std::sqrt(5.0)));
}

TEST_CASE("strided, sparse and normalized accessors are read", "[io][gltf]") {
  const TemporaryFolder folder;
  // Vertices of 20 bytes: position, then uv as two u16, then a colour as four u8.
  std::string buffer;
  for (int i = 0; i < 3; ++i) {
    buffer += f32({static_cast<float>(i), 1, 2});
    buffer += u16({65535, static_cast<uint16_t>(i * 13107)});
    buffer += std::string("\xff\x00\x33\x80", 4);
  }
  buffer += std::string("\x02\x00\x00\x00", 4);  // sparse index (u8)
  buffer += f32({7, 8, 9});                      // and its value
  const Mesh mesh = load(folder.write("a.glb", glb_file(R"({"asset": {"version": "2.0"},
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1, "COLOR_0": 2}}]}],
    "accessors": [
      {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
       "sparse": {"count": 1, "indices": {"bufferView": 1, "componentType": 5121}, "values": {"bufferView": 2}}},
      {"bufferView": 0, "byteOffset": 12, "componentType": 5123, "normalized": true, "count": 3, "type": "VEC2"},
      {"bufferView": 0, "byteOffset": 16, "componentType": 5121, "normalized": true, "count": 3, "type": "VEC4"}],
    "bufferViews": [{"buffer": 0, "byteLength": 60, "byteStride": 20},
                    {"buffer": 0, "byteOffset": 60, "byteLength": 1},
                    {"buffer": 0, "byteOffset": 64, "byteLength": 12}],
    "buffers": [{"byteLength": 76}]})",
                                                        buffer)));
  CHECK(mesh.positions == std::vector<float>{0, 1, 2, 1, 1, 2, 7, 8, 9});
  CHECK(mesh.uv == std::vector<float>{1, 0, 1, 13107 / 65535.0f, 1, 26214 / 65535.0f});
  CHECK(mesh.colors[0] == 1);
  CHECK(mesh.colors[2] == 0.2f);
  CHECK(mesh.colors[7] == 128 / 255.0f);
}

TEST_CASE("strips and fans become triangles", "[io][gltf]") {
  const TemporaryFolder folder;
  const auto with_mode = [&](int mode, std::string_view name) {
    const std::string member = R"("mode": )" + std::to_string(mode);
    // Four vertices, no indices.
    return load(folder.write(name, replaced(quad_gltf(), R"("indices": 2)", member))).indices;
  };
  CHECK(with_mode(5, "strip.gltf") == std::vector<int32_t>{0, 1, 2, 1, 3, 2});
  CHECK(with_mode(6, "fan.gltf") == std::vector<int32_t>{1, 2, 0, 2, 3, 0});
}

TEST_CASE("a primitive without texture coordinates leaves the mesh without", "[io][gltf]") {
  const TemporaryFolder folder;
  const std::string json =
      replaced(quad_gltf(), R"("indices": 2}])", R"("indices": 2}, {"attributes": {"POSITION": 0}, "indices": 2}])");
  const Mesh mesh = load(folder.write("a.gltf", json));
  CHECK(mesh.vertex_count() == 8);
  CHECK(mesh.uv.empty());
  CHECK(mesh.uv_indices.empty());
}

TEST_CASE("parts of a glTF file are bound one by one", "[io][gltf]") {
  const TemporaryFolder folder;
  const std::string path = folder.write("a.glb", quad_glb());
  CHECK(load_binding(path + ":position", 3)->width == 4);
  CHECK(load_binding(path + ":indices", 3)->width == 2);
  CHECK(load_binding(path + ":uv", 2)->to_floats() == kQuadUv);
  CHECK(load_binding(path + ":uv_indices", 3)->kind == ElementKind::Int32);

  // Colours have four components; an opaque one also fits three.
  const std::string coloured = folder.write("b.gltf", replaced(quad_gltf(), R"("TEXCOORD_0": 1})", R"("COLOR_0": 0})"));
  CHECK(load_binding(coloured + ":color")->components == 4);
  CHECK(load_binding(coloured + ":color", 3)->to_floats() == kQuadPositions);
}

}  // namespace
}  // namespace dr::io
