// SPDX-License-Identifier: Apache-2.0
// Writers: meshes survive a round trip in every format, an independent reader agrees with ours, and a failed write
// leaves what was there.

#include <sys/resource.h>
#include <tiny_gltf.h>

#include <cmath>
#include <csignal>
#include <cstring>
#include <filesystem>

#include "compiler/io/mesh/mesh.h"
#include "tests/catch.h"
#include "tests/unit/io/support.h"

namespace dr::io {
namespace {

using namespace test;
namespace fs = std::filesystem;

// A square of two triangles that share an edge, but not its texture coordinates.
Mesh seam() {
  Mesh mesh;
  mesh.positions = {0, 0, 0, 1, 0, 0.1f, 1, 1, 1e-20f, -3.25f, 1, 0};
  mesh.indices = {0, 1, 2, 0, 2, 3};
  mesh.uv = {0, 0.1f, 1, 1e-5f, 1, 1, 0.3f, 0.7f, 0, 0};
  mesh.uv_indices = {0, 1, 2, 3, 4, 2};
  return mesh;
}

void save(const std::string& path, const MeshView& mesh) {
  const Result<void> saved = save_mesh(path, mesh);
  INFO((saved.ok() ? std::string() : saved.error()));
  REQUIRE(saved.ok());
}

Array texture() { return Array::from_floats(std::vector<float>{1, 0, 0, 0, 1, 0, 0, 0, 1, 1, 1, 1}, 3, 2, 2); }

TEST_CASE("a mesh survives an OBJ file bit for bit", "[io][save]") {
  const TemporaryFolder folder;
  const Mesh mesh = seam();
  save(folder / "a.obj", MeshView::of(mesh));
  const Mesh back = load(folder / "a.obj");
  CHECK(back.positions == mesh.positions);
  CHECK(back.indices == mesh.indices);
  CHECK(back.uv == mesh.uv);
  CHECK(back.uv_indices == mesh.uv_indices);
  CHECK(folder.names() == std::vector<std::string>{"a.obj"});

  // Once more: nothing moves any further.
  save(folder / "b.obj", MeshView::of(back));
  CHECK(read_text(folder / "b.obj") == read_text(folder / "a.obj"));
}

TEST_CASE("an OBJ file names its texture", "[io][save]") {
  const TemporaryFolder folder;
  const Mesh mesh = seam();
  const Array picture = texture();
  MeshView view = MeshView::of(mesh);
  view.texture = &picture;
  save(folder / "a.obj", view);
  CHECK(folder.names() == std::vector<std::string>{"a.mtl", "a.obj", "a_texture.png"});
  CHECK(read_text(folder / "a.obj").starts_with("mtllib a.mtl\nusemtl surface\nv 0 0 0\n"));
  CHECK(read_text(folder / "a.mtl") == "newmtl surface\nKd 1 1 1\nmap_Kd a_texture.png\n");
  CHECK(load_binding(folder / "a_texture.png", 3)->to_floats() == picture.to_floats());
}

TEST_CASE("a picture whose bytes are not those of its extent is not written", "[io][save]") {
  const TemporaryFolder folder;
  const Mesh mesh = seam();
  Array picture = texture();
  picture.bytes.resize(5);
  const Array none;
  for (const std::string_view name : {"a.obj", "a.gltf", "a.glb"})
    for (const Array* bad : {&std::as_const(picture), &none}) {
      MeshView view = MeshView::of(mesh);
      view.texture = bad;
      CHECK(save_mesh(folder / name, view).error() ==
            "cannot write '" + (folder / name) +
                "': a texture: the array's extent and bytes do not agree, or it is empty");
      for (const Array* MaterialView::*member : {&MaterialView::metallic_roughness, &MaterialView::normal,
                                                 &MaterialView::occlusion, &MaterialView::emission}) {
        view = MeshView::of(mesh);
        view.material.*member = bad;
        CHECK_FALSE(save_mesh(folder / name, view).ok());
      }
    }
  CHECK(folder.names().empty());
}

TEST_CASE("normals are written at unit length", "[io][save]") {
  const TemporaryFolder folder;
  Mesh mesh = seam();
  mesh.positions.insert(mesh.positions.end(), {5, 5, 5});  // of no triangle
  mesh.normals = {1, 0, 0, 0, 2, 0, 0, 0, -3, 0.6f, 0.8f, 0, 0, 1, 0};
  std::vector<float> unit = {1, 0, 0, 0, 1, 0, 0, 0, -1, 0.6f, 0.8f, 0, 0, 1, 0};
  save(folder / "a.glb", MeshView::of(mesh));
  const Mesh back = load(folder / "a.glb");
  CHECK(std::vector<float>(back.normals.begin(), back.normals.begin() + 15) == unit);
  // In OBJ a normal is that of a corner.
  save(folder / "a.obj", MeshView::of(mesh));
  unit[13] = 0;
  unit[14] = 1;
  CHECK(load(folder / "a.obj").normals == unit);
}

TEST_CASE("a glTF vertex keeps its place and seams are appended", "[io][save]") {
  const TemporaryFolder folder;
  const Mesh mesh = seam();
  for (const std::string_view name : {"a.gltf", "a.glb"}) {
    save(folder / name, MeshView::of(mesh));
    const Mesh back = load(folder / name);
    REQUIRE(back.vertex_count() == 6);
    CHECK(std::vector<float>(back.positions.begin(), back.positions.begin() + 12) == mesh.positions);
    REQUIRE(back.indices.size() == mesh.indices.size());
    for (size_t i = 0; i < mesh.indices.size(); ++i) {
      const auto at = static_cast<size_t>(back.indices[i]);
      const auto vertex = static_cast<size_t>(mesh.indices[i]);
      const auto uv = static_cast<size_t>(mesh.uv_indices[i]);
      for (size_t k = 0; k < 3; ++k) CHECK(back.positions[at * 3 + k] == mesh.positions[vertex * 3 + k]);
      for (size_t k = 0; k < 2; ++k) CHECK(back.uv[at * 2 + k] == mesh.uv[uv * 2 + k]);
    }
    CHECK(back.normals.size() == back.positions.size());
  }
}

TEST_CASE("normals are computed where there are none", "[io][save]") {
  const TemporaryFolder folder;
  Mesh mesh;
  mesh.positions = {0, 0, 0, 1, 0, 0, 0, 1, 0, 9, 9, 9};
  mesh.indices = {0, 1, 2};
  save(folder / "a.glb", MeshView::of(mesh));
  CHECK(load(folder / "a.glb").normals == std::vector<float>{0, 0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1});

  mesh.normals = {2, 0, 0, 0, 3, 0, 0, 0, 1, 0, 0, 0};
  save(folder / "b.glb", MeshView::of(mesh));
  CHECK(load(folder / "b.glb").normals == std::vector<float>{1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 1});
}

TEST_CASE("another reader agrees with what is written", "[io][save]") {
  const TemporaryFolder folder;
  const Mesh mesh = seam();
  const Array picture = texture();
  MeshView view = MeshView::of(mesh);
  view.texture = &picture;
  for (const std::string_view name : {"a.gltf", "a.glb"}) {
    save(folder / name, view);
    tinygltf::TinyGLTF reader;
    tinygltf::Model model;
    std::string error;
    std::string warning;
    const bool read = name.ends_with("glb") ? reader.LoadBinaryFromFile(&model, &error, &warning, folder / name)
                                            : reader.LoadASCIIFromFile(&model, &error, &warning, folder / name);
    INFO(error << warning);
    REQUIRE(read);
    CHECK(error.empty());
    CHECK(warning.empty());
    REQUIRE(model.meshes.size() == 1);
    REQUIRE(model.images.size() == 1);
    CHECK(model.images[0].width == 2);
    CHECK(model.images[0].image[0] == 255);
    CHECK(model.materials[0].pbrMetallicRoughness.baseColorTexture.index == 0);
    const tinygltf::Primitive& primitive = model.meshes[0].primitives.at(0);
    const tinygltf::Accessor& position = model.accessors.at(static_cast<size_t>(primitive.attributes.at("POSITION")));
    CHECK(position.count == 6);
    CHECK(position.minValues == std::vector<double>{-3.25, 0, 0});
    CHECK(position.maxValues == std::vector<double>{1, 1, double{0.1f}});
    const tinygltf::BufferView& view_of = model.bufferViews.at(static_cast<size_t>(position.bufferView));
    float first[12];
    std::memcpy(first, model.buffers.at(0).data.data() + view_of.byteOffset, sizeof first);
    CHECK(std::equal(std::begin(first), std::end(first), mesh.positions.begin()));
    CHECK(model.accessors.at(static_cast<size_t>(primitive.indices)).count == 6);
  }
}

TEST_CASE("a material is written and read back", "[io][save]") {
  const TemporaryFolder folder;
  const Mesh mesh = seam();
  const Array picture = texture();
  const Array numbers = Array::from_floats(std::vector<float>(12, 128 / 255.0f), 3, 2, 2);
  MeshView view = MeshView::of(mesh);
  view.texture = &picture;
  view.material = {.base_color = {0.5, 0.25, 1, 1},
                   .metallic = 0.75,
                   .roughness = 0.125,
                   .emissive = {0, 0.5, 0},
                   .metallic_roughness = &numbers,
                   .normal = &numbers,
                   .occlusion = &numbers,
                   .emission = &picture};
  for (const std::string_view name : {"a.gltf", "a.glb"}) {
    save(folder / name, view);
    const auto bound = [&](std::string_view part) {
      const Result<Array> array = load_binding((folder / name) + ":material:" + std::string(part));
      INFO(part << ": " << (array.ok() ? std::string() : array.error()));
      REQUIRE(array.ok());
      return array->to_doubles();
    };
    CHECK(bound("base_color") == std::vector<double>{0.5, 0.25, 1, 1});
    CHECK(bound("metallic") == std::vector<double>{0.75});
    CHECK(bound("roughness") == std::vector<double>{0.125});
    CHECK(bound("emissive") == std::vector<double>{0, 0.5, 0});
    CHECK(bound("base_color_texture") == picture.to_doubles());
    CHECK(bound("normal_texture") == numbers.to_doubles());  // as stored: no curve
    CHECK(bound("roughness_texture") == std::vector<double>(4, numbers.to_doubles()[0]));
    CHECK(bound("occlusion_texture") == std::vector<double>(4, numbers.to_doubles()[0]));
    CHECK(bound("emissive_texture") == picture.to_doubles());
  }
  view.material.roughness = 2;
  CHECK(save_mesh(folder / "b.glb", view).error() ==
        "cannot write '" + (folder / "b.glb") + "': the material's roughness is 2, expected 0 to 1");
}

TEST_CASE("a mesh that is not one is not written", "[io][save]") {
  const TemporaryFolder folder;
  const std::string path = folder / "a.glb";
  const std::string prefix = "cannot write '" + path + "': ";
  const auto refusal = [&](const auto& change) {
    Mesh mesh = seam();
    change(mesh);
    const Result<void> saved = save_mesh(path, MeshView::of(mesh));
    REQUIRE_FALSE(saved.ok());
    CHECK(folder.names().empty());
    CHECK(saved.error().starts_with(prefix));
    return saved.error().substr(std::min(prefix.size(), saved.error().size()));
  };
  CHECK(refusal([](Mesh& m) { m.positions[4] = NAN; }) == "position 1 holds NaN");
  CHECK(refusal([](Mesh& m) { m.uv[3] = INFINITY; }) == "uv 1 holds an infinite value");
  CHECK(refusal([](Mesh& m) { m.indices[2] = 4; }) == "index 2 is 4, there are 4 entries");
  CHECK(refusal([](Mesh& m) { m.indices[2] = -1; }) == "index 2 is -1, there are 4 entries");
  CHECK(refusal([](Mesh& m) { m.uv_indices[5] = 5; }) == "uv index 5 is 5, there are 5 entries");
  CHECK(refusal([](Mesh& m) { m.indices.pop_back(); }) == "indices: 5 numbers are not a multiple of 3");
  CHECK(refusal([](Mesh& m) { m.indices.clear(); }) == "the mesh has no triangles");
  CHECK(refusal([](Mesh& m) { m.uv_indices.clear(); }) == "5 uv for 4 vertices, and no uv indices");
  CHECK(refusal([](Mesh& m) { m.uv.clear(); }) == "there are uv indices but no uv");
  CHECK(refusal([](Mesh& m) { m.normals = {0, 0, 1}; }) == "1 normals for 4 vertices");

  const Result<void> unknown = save_mesh(folder / "a.gltff", MeshView::of(seam()));
  CHECK(unknown.error() == "cannot write '" + (folder / "a.gltff") +
                               "': unknown extension '.gltff' (did you mean '.gltf'?), a mesh is .obj, .gltf or .glb");
}

TEST_CASE("an array that does not fit its format is not written", "[io][save]") {
  const TemporaryFolder folder;
  const auto refusal = [&](std::string_view name, const Array& array) {
    const std::string path = folder / name;
    const Result<void> saved = save_array(path, array);
    REQUIRE_FALSE(saved.ok());
    CHECK(folder.names().empty());
    return replaced(saved.error(), folder.path() + "/", "");
  };
  const Array floats = Array::from_floats(std::vector<float>{0, NAN, 0, 0, 0, 0}, 3);
  CHECK(refusal("a.png", floats) ==
        "cannot write 'a.png': component 1 of the element at x 0, y 0, layer 0 is NaN; .npy holds it");
  // The NaN is in the second layer: not even the first is written.
  CHECK(refusal("a.png", Array::from_floats(std::vector<float>{0, NAN}, 1, 1, 1, 2)) ==
        "cannot write 'a.png': component 0 of the element at x 0, y 0, layer 1 is NaN; .npy holds it");
  CHECK(refusal("a.png", Array::from_ints(std::vector<int32_t>{1})) ==
        "cannot write 'a.png': a PNG holds floats in 0 to 1 or bools, found int32; .npy holds any kind");
  CHECK(refusal("a.png", Array::from_floats(std::vector<float>(16), 16)) ==
        "cannot write 'a.png': a PNG holds 1 to 4 components, found 16");
  CHECK(refusal("a.png", Array::zeros(ElementKind::Bool, 1, 16385)) ==
        "cannot write 'a.png': a picture of 16385x1, sides must be in 1 to 16384");
  CHECK(refusal("a.np", floats) ==
        "cannot write 'a.np': unknown extension '.np' (did you mean '.npy'?), an array is saved as .png, .npy or .csv");
  CHECK(refusal("a", floats) == "cannot write 'a': there is no extension, an array is saved as .png, .npy or .csv");
  CHECK(refusal("a.npy", Array()) == "cannot write 'a.npy': the array's extent and bytes do not agree, or it is empty");
  CHECK(refusal("no/a.npy", floats) ==
        "cannot write 'no/a.npy': there is no folder '" + replaced(folder / "no", folder.path() + "/", "") + "'");
}

TEST_CASE("a write that fails leaves the old file and nothing else", "[io][save]") {
  const TemporaryFolder folder;
  const std::string path = folder.write("a.npy", "old");
  fs::create_directory(folder / "b.npy");
  CHECK(save_array(folder / "b.npy", Array::from_floats(std::vector<float>(4))).error() ==
        "cannot write '" + (folder / "b.npy") + "': it is a folder");

  // A limit on the size of files stands in for a full disk.
  rlimit before;
  REQUIRE(getrlimit(RLIMIT_FSIZE, &before) == 0);
  const rlimit small = {4096, before.rlim_max};
  const auto handler = std::signal(SIGXFSZ, SIG_IGN);
  REQUIRE(setrlimit(RLIMIT_FSIZE, &small) == 0);
  const Result<void> saved = save_array(path, Array::from_floats(std::vector<float>(100000)));
  setrlimit(RLIMIT_FSIZE, &before);
  std::signal(SIGXFSZ, handler);

  REQUIRE_FALSE(saved.ok());
  CHECK(saved.error() == "cannot write '" + path + "': File too large");
  CHECK(read_text(path) == "old");
  CHECK(folder.names() == std::vector<std::string>{"a.npy", "b.npy"});

  REQUIRE(save_array(path, Array::from_floats(std::vector<float>(4))).ok());
  CHECK(load_binding(path)->width == 4);
}

TEST_CASE("a symbolic link is written through", "[io][save]") {
  const TemporaryFolder folder;
  const std::string target = folder.write("target.npy", "old");
  fs::create_symlink("target.npy", folder / "link.npy");
  REQUIRE(save_array(folder / "link.npy", Array::from_floats(std::vector<float>(4))).ok());
  CHECK(fs::is_symlink(folder / "link.npy"));
  CHECK(load_binding(target)->width == 4);
}

}  // namespace
}  // namespace dr::io
