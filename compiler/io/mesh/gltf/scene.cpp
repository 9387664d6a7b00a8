// SPDX-License-Identifier: Apache-2.0
// A glTF file's scene in our own structs.
#include "compiler/io/mesh/scene.h"

#include <glm/gtc/type_ptr.hpp>

#include "compiler/io/file/failure.h"
#include "compiler/io/mesh/gltf/accessors.h"
#include "compiler/io/mesh/gltf/document.h"
#include "compiler/io/mesh/gltf/matrices.h"
#include "compiler/io/mesh/gltf/transform.h"
#include "compiler/io/mesh/mesh_readers.h"

namespace dr::io {
namespace gltf {
namespace {

// The most numbers of all animations together.
constexpr uint64_t kMaxSamples = uint64_t{1} << 26;
// The square of a quaternion's length below which it turns nothing anywhere.
constexpr double kLeastTurn = 1e-12;

const tinygltf::Value* extension(const tinygltf::ExtensionMap& all, const char* name) {
  const auto found = all.find(name);
  return found == all.end() ? nullptr : &found->second;
}

double number(const tinygltf::Value& object, const char* key, double missing) {
  return object.Has(key) ? object.Get(key).GetNumberAsDouble() : missing;
}

template <size_t N>
std::array<double, N> vector(const std::vector<double>& values, const std::array<double, N>& missing) {
  std::array<double, N> result = missing;
  if (values.size() == N) std::copy(values.begin(), values.end(), result.begin());
  return result;
}

std::array<double, 3> color(const tinygltf::Value& object, const char* key) {
  std::array<double, 3> result = {1, 1, 1};
  if (!object.Has(key)) return result;
  for (int i = 0; i < 3; ++i) result[static_cast<size_t>(i)] = object.Get(key).Get(i).GetNumberAsDouble();
  return result;
}

Scene::TextureUse texture(const tinygltf::Value& object, const char* key) {
  if (!object.Has(key)) return {};
  const tinygltf::Value& use = object.Get(key);
  return {use.Get("index").GetNumberAsInt(), static_cast<int>(number(use, "texCoord", 0))};
}

class SceneReader {
 public:
  explicit SceneReader(const Document& document) : document_(document), model_(document.model) {}

  Scene read() {
    nodes();
    for (const tinygltf::Camera& camera : model_.cameras) scene_.cameras.push_back(camera_of(camera));
    for (const tinygltf::Light& light : model_.lights) scene_.lights.push_back(light_of(light));
    for (const tinygltf::Material& material : model_.materials) scene_.materials.push_back(material_of(material));
    for (const tinygltf::Texture& texture : model_.textures) scene_.textures.push_back(texture_of(texture));
    for (const tinygltf::Image& image : model_.images) scene_.images.push_back(image.name);
    for (size_t i = 0; i < model_.skins.size(); ++i) scene_.skins.push_back(skin_of(model_.skins[i], i));
    for (size_t i = 0; i < model_.animations.size(); ++i) {
      scene_.animations.push_back(animation_of(model_.animations[i], i));
    }
    return std::move(scene_);
  }

 private:
  void nodes() {
    for (const tinygltf::Node& from : model_.nodes) {
      Scene::Node node;
      node.name = from.name;
      node.local = to_matrix(local_transform(from));
      node.mesh = from.mesh;
      node.skin = from.skin;
      node.camera = from.camera;
      if (const auto* light = extension(from.extensions, "KHR_lights_punctual")) {
        node.light = light->Get("light").GetNumberAsInt();
      }
      node.morph_weights = from.weights;
      if (from.weights.empty() && from.mesh >= 0) {
        const tinygltf::Mesh& mesh = model_.meshes[static_cast<size_t>(from.mesh)];
        node.morph_weights = mesh.weights;
        if (mesh.weights.empty() && !mesh.primitives.empty())
          node.morph_weights.resize(mesh.primitives.front().targets.size());
      }
      if (from.matrix.empty()) {
        const auto parts = [](const std::vector<double>& given, const std::vector<double>& missing) {
          return given.empty() ? missing : given;
        };
        node.translation = parts(from.translation, {0, 0, 0});
        node.rotation = parts(from.rotation, {0, 0, 0, 1});
        node.scale = parts(from.scale, {1, 1, 1});
      }
      scene_.nodes.push_back(std::move(node));
    }
    std::vector<PlacedNode> all = placed_nodes(document_);
    for (const PlacedNode& placed : all) scene_.nodes[static_cast<size_t>(placed.node)].placed = true;
    add_other_nodes(document_, all);
    for (const PlacedNode& any : all) {
      Scene::Node& node = scene_.nodes[static_cast<size_t>(any.node)];
      node.parent = any.parent;
      node.world = to_matrix(any.world);
    }
  }

  static Scene::Camera camera_of(const tinygltf::Camera& from) {
    Scene::Camera camera;
    camera.name = from.name;
    camera.perspective = from.type == "perspective";
    if (camera.perspective) {
      const tinygltf::PerspectiveCamera& p = from.perspective;
      camera.field_of_view = p.yfov;
      if (p.aspectRatio > 0) camera.aspect = p.aspectRatio;
      camera.near = p.znear;
      if (p.zfar > 0) camera.far = p.zfar;
    } else {
      const tinygltf::OrthographicCamera& o = from.orthographic;
      camera.half_height = o.ymag;
      camera.aspect = o.xmag / o.ymag;
      camera.near = o.znear;
      camera.far = o.zfar;
    }
    return camera;
  }

  static Scene::Light light_of(const tinygltf::Light& from) {
    Scene::Light light;
    light.name = from.name;
    using enum Scene::Light::Kind;
    light.kind = from.type == "directional" ? Directional : from.type == "spot" ? Spot : Point;
    light.color = vector<3>(from.color, {1, 1, 1});
    light.intensity = from.intensity;
    if (from.range > 0) light.range = from.range;
    if (light.kind == Spot) {
      light.inner_angle = from.spot.innerConeAngle;
      light.outer_angle = from.spot.outerConeAngle;
    }
    return light;
  }

  static Scene::Material material_of(const tinygltf::Material& from) {
    Scene::Material material;
    material.name = from.name;
    const tinygltf::PbrMetallicRoughness& pbr = from.pbrMetallicRoughness;
    material.base_color = vector<4>(pbr.baseColorFactor, {1, 1, 1, 1});
    material.metallic = pbr.metallicFactor;
    material.roughness = pbr.roughnessFactor;
    material.emissive = vector<3>(from.emissiveFactor, {0, 0, 0});
    material.alpha_cutoff = from.alphaCutoff;
    using enum Scene::Material::Alpha;
    material.alpha = from.alphaMode == "MASK" ? Mask : from.alphaMode == "BLEND" ? Blend : Opaque;
    material.double_sided = from.doubleSided;
    material.base_color_texture = {pbr.baseColorTexture.index, pbr.baseColorTexture.texCoord};
    material.metallic_roughness_texture = {pbr.metallicRoughnessTexture.index, pbr.metallicRoughnessTexture.texCoord};
    material.normal_texture = {from.normalTexture.index, from.normalTexture.texCoord, from.normalTexture.scale};
    material.occlusion_texture = {from.occlusionTexture.index, from.occlusionTexture.texCoord,
                                  from.occlusionTexture.strength};
    material.emissive_texture = {from.emissiveTexture.index, from.emissiveTexture.texCoord};
    if (const auto* e = extension(from.extensions, "KHR_materials_ior")) material.ior = number(*e, "ior", 1.5);
    if (const auto* e = extension(from.extensions, "KHR_materials_emissive_strength")) {
      material.emissive_strength = number(*e, "emissiveStrength", 1);
    }
    if (const auto* e = extension(from.extensions, "KHR_materials_specular")) {
      material.specular = number(*e, "specularFactor", 1);
      material.specular_color = color(*e, "specularColorFactor");
      material.specular_texture = texture(*e, "specularTexture");
      material.specular_color_texture = texture(*e, "specularColorTexture");
    }
    material.unlit = extension(from.extensions, "KHR_materials_unlit") != nullptr;
    return material;
  }

  Scene::Texture texture_of(const tinygltf::Texture& from) const {
    Scene::Texture texture;
    texture.name = from.name;
    texture.image = from.source;
    if (from.sampler >= 0) {
      const tinygltf::Sampler& sampler = model_.samplers[static_cast<size_t>(from.sampler)];
      texture.mag_filter = sampler.magFilter;
      texture.min_filter = sampler.minFilter;
      texture.wrap_u = sampler.wrapS;
      texture.wrap_v = sampler.wrapT;
    }
    return texture;
  }

  Scene::Skin skin_of(const tinygltf::Skin& from, size_t index) const {
    Scene::Skin skin;
    skin.name = from.name;
    skin.joints = from.joints;
    skin.skeleton = from.skeleton;
    skin.inverse_bind.assign(from.joints.size(), to_matrix(glm::dmat4(1.0)));
    if (from.inverseBindMatrices < 0) return skin;
    const std::string where = cat("skins[", index, "].inverseBindMatrices");
    const auto limit = static_cast<uint64_t>(kMaxVertices);
    const Floats matrices =
        read_floats(document_, static_cast<uint64_t>(from.inverseBindMatrices), {16, 16}, limit, where);
    if (matrices.values.size() / 16 < from.joints.size()) {
      fail(where, ": ", matrices.values.size() / 16, " matrices for ", from.joints.size(), " joints");
    }
    for (size_t i = 0; i < skin.joints.size(); ++i) {
      std::copy_n(matrices.values.begin() + static_cast<std::ptrdiff_t>(i * 16), 16, skin.inverse_bind[i].begin());
    }
    return skin;
  }

  Scene::Animation animation_of(const tinygltf::Animation& from, size_t index) {
    Scene::Animation animation;
    animation.name = from.name;
    for (size_t i = 0; i < from.channels.size(); ++i) {
      const tinygltf::AnimationChannel& channel = from.channels[i];
      // What has no node, and what animates other things by an extension, is not for nodes.
      if (channel.target_node < 0 || channel.target_path == "pointer") continue;
      animation.channels.push_back(channel_of(channel, from.samplers[static_cast<size_t>(channel.sampler)],
                                              cat("animations[", index, "].samplers[", channel.sampler, "]")));
    }
    return animation;
  }

  Scene::Channel channel_of(const tinygltf::AnimationChannel& from, const tinygltf::AnimationSampler& sampler,
                            const std::string& where) {
    Scene::Channel channel;
    channel.node = from.target_node;
    channel.path = from.target_path;
    channel.interpolation = sampler.interpolation;
    channel.times =
        read_floats(document_, static_cast<uint64_t>(sampler.input), {1, 1}, kMaxSamples, where + ".input").values;
    for (size_t i = 1; i < channel.times.size(); ++i) {
      if (!(channel.times[i] > channel.times[i - 1])) {
        fail(where, ".input: time ", i, " is ", channel.times[i], " after ", channel.times[i - 1],
             ", they must increase");
      }
    }
    const uint64_t components = channel.path == "rotation" ? 4 : channel.path == "weights" ? 1 : 3;
    channel.values = read_floats(document_, static_cast<uint64_t>(sampler.output),
                                 {components, components, Integers::Normalized}, kMaxSamples, where + ".output")
                         .values;
    samples_ += channel.times.size() + channel.values.size();
    if (samples_ > kMaxSamples) fail("the animations have more than ", kMaxSamples, " numbers together");
    const size_t groups = channel.times.size() * (channel.interpolation == "CUBICSPLINE" ? 3 : 1);
    const bool fits =
        channel.path == "weights" ? channel.values.size() % groups == 0 : channel.values.size() == groups * components;
    if (!fits) {
      fail(where, ".output: ", channel.values.size() / components, " values for ", channel.times.size(), " times (",
           channel.interpolation, ")");
    }
    if (channel.path == "rotation") check_turns(channel, where);
    return channel;
  }

  // Keys need not have the length 1, but a direction.
  static void check_turns(const Scene::Channel& channel, const std::string& where) {
    const bool cubic = channel.interpolation == "CUBICSPLINE";
    for (size_t key = 0; key < channel.times.size(); ++key) {
      const float* const q = channel.values.data() + 4 * (cubic ? 3 * key + 1 : key);
      double square = 0;
      for (size_t i = 0; i < 4; ++i) square += double{q[i]} * q[i];
      if (!(square > kLeastTurn)) fail(where, ".output: key ", key, " is not a unit quaternion");
    }
  }

  const Document& document_;
  const tinygltf::Model& model_;
  Scene scene_;
  uint64_t samples_ = 0;
};

}  // namespace

Scene read_scene(const Document& document) { return SceneReader(document).read(); }

}  // namespace gltf

Result<Scene> load_scene(const std::string& path) {
  return guarded(cat("cannot read ", path_in_quotes(path), ": "), [&] {
    const Bytes content = read_file(path);
    return gltf::read_scene(gltf::load_document(content, path));
  });
}

}  // namespace dr::io
