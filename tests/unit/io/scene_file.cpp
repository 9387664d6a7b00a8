// SPDX-License-Identifier: Apache-2.0
#include <cassert>

#include "tests/unit/io/support.h"

namespace dr::io::test {

SceneFile::SceneFile() {
  const int position = add("VEC3", 5126, 3, f32({0, 0, 0, 1, 0, 0, 0, 1, 0}));
  const int normal = add("VEC3", 5126, 3, f32({0, 0, 1, 0, 0, 1, 0, 0, 1}));
  const int joints = add("VEC4", 5121, 3, std::string("\0\1\0\0\0\1\0\0\1\0\0\0", 12));
  const int weights = add("VEC4", 5126, 3, f32({1, 0, 0, 0, 0.5f, 0.5f, 0, 0, 1, 0, 0, 0}));
  const int uv1 = add("VEC2", 5126, 3, f32({0, 0, 1, 0, 0, 1}));
  const int tangent = add("VEC4", 5126, 3, f32({1, 0, 0, -1, 1, 0, 0, -1, 1, 0, 0, -1}));
  const int delta = add("VEC3", 5126, 3, f32({0, 0, 0, 0, 0, 2, 0, 0, 0}));
  const int bind = add("MAT4", 5126, 2, f32({1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, -1, -1, 0, 1,  //
                                             1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, -1, -3, 0, 1}));
  const int times = add("SCALAR", 5126, 2, f32({0, 2}));
  const int turns = add("VEC4", 5126, 2, f32({0, 0, 0, 1, 0, 0, 0.70710678f, 0.70710678f}));
  const std::string png = png_file(2, 1, 8, 2, std::string("\0\xff\x80\0\0\0\xff", 7));
  const auto text = [](int number) { return std::to_string(number); };
  json_ = R"({"asset": {"version": "2.0"},
    "extensionsUsed": ["KHR_lights_punctual", "KHR_materials_ior"], "extensionsRequired": ["KHR_lights_punctual"],
    "extensions": {"KHR_lights_punctual": {"lights": [
      {"type": "spot", "color": [1, 0.5, 0], "intensity": 7, "range": 9, "spot": {"outerConeAngle": 0.5235987755982988}},
      {"type": "directional", "name": "Sun"}]}},
    "scene": 0, "scenes": [{"nodes": [0]}],
    "nodes": [
      {"name": "Root", "translation": [0, 1, 0], "children": [1, 2, 3, 4, 6]},
      {"name": "Eye", "camera": 0, "translation": [0, 0, 5], "scale": [2, 2, 2]},
      {"name": "Lamp", "rotation": [-0.7071067811865476, 0, 0, 0.7071067811865476],
       "extensions": {"KHR_lights_punctual": {"light": 0}}},
      {"name": "Body", "mesh": 0, "skin": 0},
      {"name": "Hip", "translation": [1, 0, 0], "children": [5]},
      {"name": "Knee", "translation": [0, 2, 0]},
      {"extensions": {"KHR_lights_punctual": {"light": 1}}}],
    "cameras": [{"type": "perspective", "name": "own",
                 "perspective": {"yfov": 1.0471975511965976, "znear": 0.5, "zfar": 50, "aspectRatio": 1.5}}],
    "meshes": [{"weights": [0.25], "primitives": [{"material": 1, "targets": [{"POSITION": )" +
          text(delta) + R"(}], "attributes": {"POSITION": )" + text(position) + R"(, "NORMAL": )" + text(normal) +
          R"(, "TANGENT": )" + text(tangent) + R"(, "TEXCOORD_1": )" + text(uv1) + R"(, "JOINTS_0": )" + text(joints) +
          R"(, "WEIGHTS_0": )" + text(weights) + R"(}}]}],
    "skins": [{"joints": [4, 5], "inverseBindMatrices": )" +
          text(bind) + R"(}],
    "animations": [{"name": "Walk", "samplers": [{"input": )" +
          text(times) + R"(, "output": )" + text(turns) + R"(}],
      "channels": [{"sampler": 0, "target": {"node": 5, "path": "rotation"}}]}],
    "materials": [{"name": "Plain"}, {"name": "Metal", "doubleSided": true, "alphaMode": "MASK",
      "emissiveFactor": [0, 0.5, 1],
      "pbrMetallicRoughness": {"baseColorFactor": [0.1, 0.2, 0.3, 0.4], "metallicFactor": 0.75, "roughnessFactor": 0.25,
        "baseColorTexture": {"index": 0}, "metallicRoughnessTexture": {"index": 0}},
      "normalTexture": {"index": 0, "scale": 0.5},
      "extensions": {"KHR_materials_ior": {"ior": 1.25}, "KHR_materials_emissive_strength": {"emissiveStrength": 4},
        "KHR_materials_specular": {"specularFactor": 0.5, "specularColorFactor": [1, 2, 3]},
        "KHR_materials_unlit": {}}}],
    "textures": [{"source": 0, "sampler": 0}], "samplers": [{"magFilter": 9728, "wrapS": 33071}],
    "images": [{"name": "dots", "uri": "data:image/png;base64,)" +
          base64(png) + R"("}],
    "accessors": [)" +
          accessors_ + R"(], "bufferViews": [)" + views_ + R"(],
    "buffers": [{"byteLength": )" +
          std::to_string(buffer_.size()) + "}]}";
}

std::string SceneFile::glb(std::string_view from, std::string_view to) const {
  const std::string json = replaced(json_, from, to);
  assert(json != json_);
  return glb_file(json, buffer_);
}

int SceneFile::add(std::string_view type, int component, int count, const std::string& bytes) {
  const std::string comma = count_ > 0 ? ", " : "";
  views_ += comma + R"({"buffer": 0, "byteOffset": )" + std::to_string(buffer_.size()) + R"(, "byteLength": )" +
            std::to_string(bytes.size()) + "}";
  accessors_ += comma + R"({"bufferView": )" + std::to_string(count_) + R"(, "componentType": )" +
                std::to_string(component) + R"(, "count": )" + std::to_string(count) + R"(, "type": ")" +
                std::string(type) + "\"}";
  buffer_ += bytes;
  return count_++;
}

}  // namespace dr::io::test
