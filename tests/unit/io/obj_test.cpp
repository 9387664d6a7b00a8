// SPDX-License-Identifier: Apache-2.0
// OBJ files as they are found: fans, relative indices, comments, continued lines, normals and colours.

#include "compiler/io/mesh/mesh.h"
#include "tests/catch.h"
#include "tests/unit/io/support.h"

namespace dr::io {
namespace {

using test::TemporaryFolder;

Mesh load_obj(std::string_view text) {
  const TemporaryFolder folder;
  Result<Mesh> mesh = load_mesh(folder.write("mesh.obj", text));
  INFO((mesh.ok() ? std::string() : mesh.error()));
  REQUIRE(mesh.ok());
  return std::move(*mesh);
}

TEST_CASE("an OBJ polygon becomes a fan", "[io][obj]") {
  const Mesh mesh = load_obj("v 0 0 0\nv 1 0 0\nv 2 1 0\nv 1 2 0\nv 0 1 0\nf 1 2 3 4 5\n");
  CHECK(mesh.vertex_count() == 5);
  CHECK(mesh.indices == std::vector<int32_t>{0, 1, 2, 0, 2, 3, 0, 3, 4});
  CHECK(mesh.uv.empty());
  CHECK(mesh.normals.empty());
}

TEST_CASE("OBJ texture coordinates have their own indices and a top-left origin", "[io][obj]") {
  const Mesh mesh = load_obj("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0.25\nvt 1\nf 1/1 2/2 3/1\n");
  CHECK(mesh.uv == std::vector<float>{0, 0.75f, 1, 1});
  CHECK(mesh.uv_indices == std::vector<int32_t>{0, 1, 0});
}

TEST_CASE("OBJ indices may count back and vertices may come late", "[io][obj]") {
  const Mesh mesh = load_obj("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nf 1 2 4\nv 5 5 5\n");
  CHECK(mesh.indices == std::vector<int32_t>{0, 1, 2, 0, 1, 3});
}

TEST_CASE("OBJ comments, blanks, joined lines and other line ends are read", "[io][obj]") {
  const Mesh mesh = load_obj(
      "\xef\xbb\xbf# a file \\\r\no thing\r\n\r\n\tv +0 0 -0.5e0 # first\r\nv 1 \\\r\n 0 0\r\nv 0 1 0\r\n"
      "s off\nusemtl x\nl 1 2\nf 1 \\\n2 \\\n3");
  CHECK(mesh.vertex_count() == 3);
  CHECK(mesh.positions[2] == -0.5f);
  CHECK(mesh.indices == std::vector<int32_t>{0, 1, 2});
}

TEST_CASE("numbers too small for a float are zero", "[io][obj]") {
  const Mesh mesh = load_obj("v 1e-400 0 0\nv 1 1e-60 0\nv 0 1 0\nf 1 2 3\n");
  CHECK(mesh.positions[0] == 0);
  CHECK(mesh.positions[4] == 0);
}

TEST_CASE("an OBJ vertex gets the mean of its different normals", "[io][obj]") {
  // Vertex 1 is used with +z twice and with +x once: the mean of the two, however often each is named.
  const Mesh mesh = load_obj(
      "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvn 0 0 2\nvn 1 0 0\n"
      "f 1//1 2//1 3//1\nf 1//1 3//1 4//1\nf 1//2 4//2 3//2\n");
  REQUIRE(mesh.normals.size() == 12);
  CHECK(mesh.normals[0] == Approx(0.70710678f));
  CHECK(mesh.normals[2] == Approx(0.70710678f));
  CHECK(mesh.normals[3] == 0);
  CHECK(mesh.normals[5] == 1);
}

TEST_CASE("what only part of an OBJ file has is left out", "[io][obj]") {
  const Mesh mesh = load_obj("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\nf 3 2 1\n");
  CHECK(mesh.uv.empty());
  CHECK(mesh.uv_indices.empty());
}

TEST_CASE("OBJ vertices may carry colours", "[io][obj]") {
  const Mesh mesh = load_obj("v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 0.5\nf 1 2 3\n");
  CHECK(mesh.colors == std::vector<float>{1, 0, 0, 1, 0, 1, 0, 1, 0, 0, 0.5f, 1});
}

TEST_CASE("parts of an OBJ file are bound one by one", "[io][obj]") {
  const TemporaryFolder folder;
  const std::string path =
      folder.write("m.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvn 0 0 1\nf 1/1/1 2/2/1 3/1/1\n");
  const Result<Array> position = load_binding(path + ":position", 3);
  REQUIRE(position.ok());
  CHECK(position->kind == ElementKind::Float32);
  CHECK(position->components == 3);
  CHECK(position->width == 3);
  CHECK(load_binding(path + ":indices", 3)->kind == ElementKind::Int32);
  CHECK(load_binding(path + ":indices")->as<int32_t>()[2] == 2);
  CHECK(load_binding(path + ":uv", 2)->width == 2);
  CHECK(load_binding(path + ":uv_indices")->as<int32_t>()[1] == 1);
  CHECK(load_binding(path + ":normal")->as<float>()[2] == 1);

  const std::string cloud = folder.write("cloud.obj", "v 0 0 0\nv 1 2 3\n");
  CHECK(load_binding(cloud + ":position")->width == 2);
  CHECK_FALSE(load_mesh(cloud).ok());
}

}  // namespace
}  // namespace dr::io
