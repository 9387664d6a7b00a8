// SPDX-License-Identifier: Apache-2.0
#include "compiler/io/mesh/gltf/write.h"

#include <tiny_gltf.h>

#include <algorithm>
#include <bit>
#include <limits>
#include <sstream>

#include "compiler/io/file/failure.h"
#include "compiler/io/picture/image.h"

namespace dr::io::gltf {
namespace {

class Writer {
 public:
  Writer() { model_.buffers.resize(1); }

  tinygltf::Model model(const WeldedMesh& mesh, const Array* texture, const MaterialView& material) {
    model_.asset.version = "2.0";
    model_.asset.generator = "Dressi";
    model_.defaultScene = 0;
    model_.scenes.resize(1);
    model_.scenes[0].nodes = {0};
    model_.nodes.resize(1);
    model_.nodes[0].mesh = 0;
    tinygltf::Primitive primitive;
    primitive.mode = TINYGLTF_MODE_TRIANGLES;
    primitive.material = 0;
    primitive.attributes["POSITION"] = add_floats(mesh.positions, TINYGLTF_TYPE_VEC3, true);
    primitive.attributes["NORMAL"] = add_floats(mesh.normals, TINYGLTF_TYPE_VEC3, false);
    if (!mesh.uv.empty()) primitive.attributes["TEXCOORD_0"] = add_floats(mesh.uv, TINYGLTF_TYPE_VEC2, false);
    primitive.indices = add_indices(mesh.indices);
    model_.meshes.resize(1);
    model_.meshes[0].primitives.push_back(std::move(primitive));
    add_material(texture, material);
    return std::move(model_);
  }

 private:
  Bytes& buffer() { return model_.buffers[0].data; }

  // What was appended from `offset` on. Pads the buffer, so that every view starts at a multiple of 4.
  int add_view(size_t offset, int target) {
    tinygltf::BufferView view;
    view.buffer = 0;
    view.byteOffset = offset;
    view.byteLength = buffer().size() - offset;
    view.target = target;
    while (buffer().size() % 4 != 0) buffer().push_back(0);
    model_.bufferViews.push_back(std::move(view));
    return static_cast<int>(model_.bufferViews.size()) - 1;
  }

  void append_u32(uint32_t value) {
    for (int shift = 0; shift < 32; shift += 8) buffer().push_back(static_cast<uint8_t>(value >> shift));
  }

  int add_floats(const std::vector<float>& values, int type, bool with_bounds) {
    const auto components = static_cast<size_t>(tinygltf::GetNumComponentsInType(static_cast<uint32_t>(type)));
    const size_t offset = buffer().size();
    for (const float value : values) append_u32(std::bit_cast<uint32_t>(value));
    tinygltf::Accessor accessor;
    accessor.bufferView = add_view(offset, TINYGLTF_TARGET_ARRAY_BUFFER);
    accessor.componentType = TINYGLTF_COMPONENT_TYPE_FLOAT;
    accessor.count = values.size() / components;
    accessor.type = type;
    if (with_bounds) {
      accessor.minValues.assign(components, std::numeric_limits<double>::infinity());
      accessor.maxValues.assign(components, -std::numeric_limits<double>::infinity());
      for (size_t i = 0; i < values.size(); ++i) {
        double& low = accessor.minValues[i % components];
        double& high = accessor.maxValues[i % components];
        low = std::min(low, double{values[i]});
        high = std::max(high, double{values[i]});
      }
    }
    return add_accessor(std::move(accessor));
  }

  int add_indices(const std::vector<uint32_t>& indices) {
    const size_t offset = buffer().size();
    for (const uint32_t index : indices) append_u32(index);
    tinygltf::Accessor accessor;
    accessor.bufferView = add_view(offset, TINYGLTF_TARGET_ELEMENT_ARRAY_BUFFER);
    accessor.componentType = TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT;
    accessor.count = indices.size();
    accessor.type = TINYGLTF_TYPE_SCALAR;
    return add_accessor(std::move(accessor));
  }

  int add_accessor(tinygltf::Accessor accessor) {
    model_.accessors.push_back(std::move(accessor));
    return static_cast<int>(model_.accessors.size()) - 1;
  }

  // The number of the texture, or -1 for none.
  int add_texture(const Array* picture, bool colour) {
    if (!picture) return -1;
    const Bytes png = encode_png(*picture, 0, !colour);
    const size_t offset = buffer().size();
    buffer().insert(buffer().end(), png.begin(), png.end());
    tinygltf::Image image;
    image.mimeType = "image/png";
    image.bufferView = add_view(offset, 0);
    model_.images.push_back(std::move(image));
    if (model_.samplers.empty()) {
      model_.samplers.resize(1);
      model_.samplers[0].magFilter = TINYGLTF_TEXTURE_FILTER_LINEAR;
      model_.samplers[0].minFilter = TINYGLTF_TEXTURE_FILTER_LINEAR_MIPMAP_LINEAR;
    }
    tinygltf::Texture texture;
    texture.sampler = 0;
    texture.source = static_cast<int>(model_.images.size()) - 1;
    model_.textures.push_back(std::move(texture));
    return static_cast<int>(model_.textures.size()) - 1;
  }

  void add_material(const Array* texture, const MaterialView& from) {
    tinygltf::Material material;
    material.doubleSided = true;  // both sides are drawn: a surface under optimisation need not be closed
    tinygltf::PbrMetallicRoughness& pbr = material.pbrMetallicRoughness;
    pbr.baseColorFactor.assign(from.base_color.begin(), from.base_color.end());
    pbr.metallicFactor = from.metallic;
    pbr.roughnessFactor = from.roughness;
    // A factor is 1 at most, and brighter light has a strength besides.
    const double strength = std::max(1.0, std::ranges::max(from.emissive));
    for (const double factor : from.emissive) material.emissiveFactor.push_back(factor / strength);
    if (strength > 1) {
      constexpr const char* kStrength = "KHR_materials_emissive_strength";
      material.extensions[kStrength] =
          tinygltf::Value(tinygltf::Value::Object{{"emissiveStrength", tinygltf::Value(strength)}});
      model_.extensionsUsed.push_back(kStrength);
    }
    pbr.baseColorTexture.index = add_texture(texture, true);
    pbr.metallicRoughnessTexture.index = add_texture(from.metallic_roughness, false);
    material.normalTexture.index = add_texture(from.normal, false);
    material.occlusionTexture.index = add_texture(from.occlusion, false);
    material.emissiveTexture.index = add_texture(from.emission, true);
    model_.materials.push_back(std::move(material));
  }

  tinygltf::Model model_;
};

}  // namespace

Bytes write(const WeldedMesh& mesh, const Array* texture, const MaterialView& material, bool binary) {
  const tinygltf::Model model = Writer().model(mesh, texture, material);
  // The JSON of one mesh takes some kilobytes.
  constexpr uint64_t kMost = std::numeric_limits<uint32_t>::max() - (1u << 20);
  const uint64_t bytes = model.buffers[0].data.size();
  if (bytes > kMost) fail("a glTF buffer of ", bytes, " bytes, the limit is ", kMost);
  tinygltf::TinyGLTF writer;
  writer.SetImageWriter(nullptr, nullptr);  // pictures are in the buffer
  std::ostringstream out;
  if (!writer.WriteGltfSceneToStream(&model, out, true, binary) || !out) fail("tinygltf does not write it");
  const std::string text = std::move(out).str();
  return Bytes(text.begin(), text.end());
}

}  // namespace dr::io::gltf
