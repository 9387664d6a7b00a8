// SPDX-License-Identifier: Apache-2.0
// Any bytes as a file of the format DR_READER: words that say what is wrong, or data that programs can rely on.
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <string>

#include "compiler/io/array/npy.h"
#include "compiler/io/file/failure.h"
#include "compiler/io/mesh/gltf/document.h"
#include "compiler/io/mesh/mesh_readers.h"
#include "compiler/io/mesh/strands.h"
#include "compiler/io/picture/image.h"
#include "tests/fuzz/repair.h"

namespace {

using namespace dr::io;

constexpr size_t kMaxInput = size_t{1} << 16;
// Decoded: what a small file may stand for is bounded by the readers, but not to what thousands of runs have time for.
constexpr int64_t kMaxPixels = int64_t{1} << 20;

void require(bool holds) {
  if (!holds) std::abort();
}

[[maybe_unused]] void check(const Array& array) { require(array.consistent()); }

[[maybe_unused]] void check(const Mesh& mesh) {
  for (const auto* values : {&mesh.positions, &mesh.uv, &mesh.normals, &mesh.tangents, &mesh.weights}) {
    for (const float value : *values) require(std::isfinite(value));
  }
  require(mesh.positions.size() % 3 == 0 && !mesh.indices.empty() && mesh.indices.size() % 3 == 0);
  for (const int32_t index : mesh.indices) require(index >= 0 && index < mesh.vertex_count());
  for (const int32_t index : mesh.uv_indices) require(index >= 0 && static_cast<size_t>(index) < mesh.uv.size() / 2);
  for (const Mesh::Morph& morph : mesh.morphs) require(morph.positions.size() % 3 == 0);
}

[[maybe_unused]] void check(const Strands& strands) {
  size_t vertices = 0;
  for (const int32_t count : strands.vertices) {
    require(count >= 2);
    vertices += static_cast<size_t>(count);
  }
  require(strands.positions.size() == 3 * vertices);
  for (const auto* values :
       {&strands.positions, &strands.widths, &strands.opacities, &strands.colors, &strands.root_uv}) {
    for (const float value : *values) require(std::isfinite(value));
  }
}

[[maybe_unused]] void check(const Scene& scene) {
  const auto world = [&] {
    std::vector<Matrix> matrices;
    for (const Scene::Node& node : scene.nodes) matrices.push_back(node.world);
    return matrices;
  }();
  for (size_t i = 0; i < scene.skins.size(); ++i) {
    require(joint_matrices(scene, i, world).size() == scene.skins[i].joints.size());
  }
  for (size_t i = 0; i < scene.animations.size(); ++i) require(pose_at(scene, i, 0.5).size() == scene.nodes.size());
}

void read([[maybe_unused]] std::span<const uint8_t> bytes) {
#if DR_READER == 0
  const gltf::Document document = gltf::load_document(bytes, "nowhere/a.gltf");
  check(gltf::read_scene(document));
  check(parse_gltf(bytes, "nowhere/a.gltf", std::nullopt));
#elif DR_READER == 1
  check(parse_obj(as_text(bytes), std::nullopt));
#elif DR_READER == 2 || DR_READER == 3
  const std::vector<uint8_t> file =
      DR_READER == 2 ? dr::fuzz::with_checksums(bytes) : Bytes(bytes.begin(), bytes.end());
  if (file.empty()) return;
  const PictureSize size = file[0] == 0x89 ? check_png(file) : check_jpeg(file);
  if (size.width * size.height <= kMaxPixels) check(to_array(decode_png_or_jpeg(file), {}));
#elif DR_READER == 4
  check(to_array(decode_hdr(bytes), {}));
#elif DR_READER == 5
  check(parse_npy(bytes, 0));
#elif DR_READER == 6
  check(parse_csv(as_text(bytes), 0));
#elif DR_READER == 7
  check(parse_literal(as_text(bytes), 0));
#else
  check(as_text(bytes).starts_with("HAIR") ? parse_hair(bytes) : parse_tfx(bytes));
#endif
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size > kMaxInput) return 0;
  try {
    read({data, size});
  } catch (const Failure&) {  // in words
  } catch (const std::bad_alloc&) {
  }
  return 0;
}
