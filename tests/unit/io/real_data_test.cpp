// SPDX-License-Identifier: Apache-2.0
// Real meshes and pictures, in the folder that DR_DATA names or beside the repository. Without it there is nothing to
// do.

#include <tiny_gltf.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <optional>

#include "compiler/io/mesh/mesh.h"
#include "tests/catch.h"
#include "tests/unit/io/support.h"

namespace dr::io {
namespace {

using namespace test;

// The data folder, or a word in the report that there is none.
std::optional<std::string> real_data() {
  auto data = data_folder();
  if (!data) WARN("skipped: there is no data folder, name one in DR_DATA");
  return data;
}

struct Expected {
  std::string_view file;
  int64_t vertices;
  int64_t triangles;
  int64_t uv;  // 0: none
};

TEST_CASE("real meshes have the counts that other tools find", "[io][data]") {
  const auto data = real_data();
  if (!data) return;
  const Expected all[] = {
      {"gltf/Avocado/Avocado.gltf", 406, 682, 406},
      {"gltf/LeePerrySmith/LeePerrySmith.glb", 9279, 17684, 9279},
      {"gltf/armchair/armchair.gltf", 10800, 18400, 10800},
      {"gltf/MaterialsVariantsShoe/MaterialsVariantsShoe.gltf", 13540, 22700, 13540},
      {"obj/spot/cow.obj", 2930, 5856, 3225},
      {"obj/blub/blub_triangulated.obj", 7106, 14208, 7317},
      {"obj/bob/bob_tri.obj", 5344, 10688, 5647},
      {"obj/pizza/pizza.obj", 24916, 49954, 48612},
      {"obj/teapot/teapot.obj", 7850, 15704, 8334},
      {"obj/teapot/teapot_small.obj", 1292, 2464, 0},
      {"obj/nefertiti/nefertiti-lowres.obj", 35002, 70000, 0},
      {"obj/skull/skull_low_resolution.obj", 5154, 10312, 0},
  };
  for (const Expected& expected : all) {
    INFO(expected.file);
    const std::string path = *data + "/" + std::string(expected.file);
    if (!std::filesystem::exists(path)) continue;
    const Mesh mesh = load(path);
    CHECK(mesh.vertex_count() == expected.vertices);
    CHECK(mesh.triangle_count() == expected.triangles);
    CHECK(static_cast<int64_t>(mesh.uv.size() / 2) == expected.uv);
    CHECK((mesh.uv_indices.empty() ? 0 : mesh.indices.size()) == mesh.uv_indices.size());
  }
}

TEST_CASE("texture coordinates of an OBJ file find their texels", "[io][data]") {
  const auto data = real_data();
  if (!data) return;
  // The darkest texels of Spot are its pupils, and the vertices on them lie on both sides of the face. With v the wrong
  // way up there would be none there.
  const Mesh mesh = load(*data + "/obj/spot/cow.obj");
  const Result<Array> picture = load_binding(*data + "/obj/spot/cow_texture.png", 3);
  REQUIRE(picture.ok());
  const auto texels = picture->as<float>();
  const auto is_dark = [&](const float* uv) {
    const auto x = static_cast<int64_t>(std::clamp(uv[0], 0.0f, 0.999f) * static_cast<float>(picture->width));
    const auto y = static_cast<int64_t>(std::clamp(uv[1], 0.0f, 0.999f) * static_cast<float>(picture->height));
    const auto at = static_cast<size_t>((y * picture->width + x) * 3);
    return texels[at] + texels[at + 1] + texels[at + 2] < 0.1f;
  };
  int left = 0;
  int right = 0;
  bool all_in_the_face = true;
  for (size_t i = 0; i < mesh.indices.size(); ++i) {
    if (!is_dark(&mesh.uv[static_cast<size_t>(mesh.uv_indices[i]) * 2])) continue;
    const float* p = &mesh.positions[static_cast<size_t>(mesh.indices[i]) * 3];
    ++(p[0] < 0 ? left : right);
    all_in_the_face = all_in_the_face && p[2] < -0.4f;
  }
  CHECK(left > 10);
  CHECK(right > 10);
  CHECK(all_in_the_face);
}

TEST_CASE("another reader finds the same triangles", "[io][data]") {
  const auto data = real_data();
  if (!data) return;
  for (const std::string_view file : {"gltf/Avocado/Avocado.gltf", "gltf/LeePerrySmith/LeePerrySmith.glb"}) {
    const std::string path = *data + "/" + std::string(file);
    if (!std::filesystem::exists(path)) continue;
    INFO(file);
    const Mesh mesh = load(path);
    tinygltf::TinyGLTF reader;
    reader.SetImageLoader([](tinygltf::Image*, int, std::string*, std::string*, int, int, const unsigned char*, int,
                             void*) { return true; },
                          nullptr);
    tinygltf::Model model;
    std::string error;
    std::string warning;
    REQUIRE((path.ends_with("glb") ? reader.LoadBinaryFromFile(&model, &error, &warning, path)
                                   : reader.LoadASCIIFromFile(&model, &error, &warning, path)));
    const tinygltf::Primitive& primitive = model.meshes.at(0).primitives.at(0);
    const auto& indices = model.accessors.at(static_cast<size_t>(primitive.indices));
    const auto& uv = model.accessors.at(static_cast<size_t>(primitive.attributes.at("TEXCOORD_0")));
    REQUIRE(indices.count == mesh.indices.size());
    const auto data_of = [&](const tinygltf::Accessor& accessor) {
      const auto& view = model.bufferViews.at(static_cast<size_t>(accessor.bufferView));
      return model.buffers.at(static_cast<size_t>(view.buffer)).data.data() + view.byteOffset + accessor.byteOffset;
    };
    REQUIRE(indices.componentType == TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT);
    bool same = true;
    for (size_t i = 0; i < indices.count; ++i) {
      const unsigned char* p = data_of(indices) + i * 2;
      same = same && mesh.indices[i] == (p[0] | p[1] << 8);
    }
    CHECK(same);
    const int stride = uv.ByteStride(model.bufferViews.at(static_cast<size_t>(uv.bufferView)));
    float first[2];
    std::memcpy(first, data_of(uv) + stride, sizeof first);
    CHECK(first[0] == mesh.uv[2]);
    CHECK(first[1] == mesh.uv[3]);
  }
}

TEST_CASE("real meshes survive being written", "[io][data]") {
  const auto data = real_data();
  if (!data) return;
  const TemporaryFolder folder;
  const Mesh cow = load(*data + "/obj/spot/cow.obj");
  REQUIRE(save_mesh(folder / "cow.obj", MeshView::of(cow)).ok());
  const Mesh back = load(folder / "cow.obj");
  CHECK(back.positions == cow.positions);
  CHECK(back.indices == cow.indices);
  CHECK(back.uv == cow.uv);
  CHECK(back.uv_indices == cow.uv_indices);
  REQUIRE(save_mesh(folder / "cow.glb", MeshView::of(cow)).ok());
  const Mesh welded = load(folder / "cow.glb");
  CHECK(welded.vertex_count() == 3225);
  CHECK(welded.triangle_count() == 5856);
}

TEST_CASE("real pictures are read", "[io][data]") {
  const auto data = real_data();
  if (!data) return;

  const Result<Array> sky = load_binding(*data + "/hdr/venice_sunset_1k.hdr", 3);
  REQUIRE(sky.ok());
  CHECK(sky->width == 1024);
  CHECK(sky->height == 512);
  const auto values = sky->as<float>();
  CHECK(*std::max_element(values.begin(), values.end()) == Approx(6496).epsilon(1e-3));
  double sum = 0;
  for (const float value : values) sum += value;
  CHECK(sum / static_cast<double>(values.size()) == Approx(0.46).margin(0.01));

  const Result<Array> progressive = load_binding(*data + "/gltf/MaterialsVariantsShoe/diffuseBeach.jpg", 3);
  REQUIRE(progressive.ok());
  CHECK(progressive->width == 1024);

  // Twelve masks, some with a second channel that says nothing.
  const std::string masks = *data + "/multiview/maize_plant/bin/side/*.png";
  if (!std::filesystem::exists(*data + "/multiview/maize_plant")) return;
  const Result<Array> stack = load_binding(masks + ":r", 1);
  INFO((stack.ok() ? std::string() : stack.error()));
  REQUIRE(stack.ok());
  CHECK(stack->layers == 12);
  CHECK(stack->width == 2056);
  CHECK(stack->height == 2454);
  CHECK_FALSE(load_binding(masks, 1).ok());
}

}  // namespace
}  // namespace dr::io
