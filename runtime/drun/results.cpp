// SPDX-License-Identifier: Apache-2.0
// Results as files.
#include "runtime/drun/results.h"

#include <charconv>
#include <cstdio>
#include <filesystem>
#include <map>
#include <optional>
#include <sstream>

#include "compiler/io/mesh/mesh.h"
#include "runtime/drun/mesh_material.h"

namespace dr::drun {

using io::Array;

std::string number_text(double value) {
  char text[32];
  return {text, std::to_chars(text, text + sizeof text, static_cast<float>(value)).ptr};
}

void Results::write_outputs(const std::string& folder, const std::set<std::string>& ran) const {
  const std::filesystem::path out = folder;
  // A name that several steps give, or that a leaf has too, is told apart by its step.
  std::map<std::string, int> uses;
  for (const auto& leaf : names_.leaves())
    if (changed(leaf.name)) ++uses[leaf.name];
  for (const std::string& step : ran)
    for (const std::string& name : names_.outputs(step)) ++uses[name];
  for (const std::string& step : ran)
    for (const std::string& name : names_.outputs(step)) {
      const Array a = must(target_.output(step, name));
      const std::string stem = uses[name] > 1 ? step + "." + name : name;
      must(io::save_array((out / (stem + ".npy")).string(), a));
      const bool picture = a.height > 1 && (a.components == 1 || a.components >= 3) && a.components <= 4 &&
                           a.kind == io::ElementKind::Float32;
      if (!picture) continue;
      // The array is saved; a picture that cannot be (NaN) must not cost what comes after it.
      if (auto saved = io::save_array((out / (stem + ".png")).string(), a); !saved)
        std::fprintf(stderr, "drun: warning: %s\n", saved.error().c_str());
    }
}

std::vector<std::pair<std::string, Array>> Results::leaves(const std::set<std::string>& ran) const {
  std::set<std::string> needed;
  for (const std::string& step : ran)
    for (const std::string& name : names_.needed_leaves(step)) needed.insert(name);
  std::vector<std::pair<std::string, Array>> out;
  for (const auto& leaf : names_.leaves()) {
    if (!changed(leaf.name)) continue;
    auto value = target_.leaf(leaf.name);
    if (!value && needed.count(leaf.name) == 0) continue;  // nothing that ran needs it, and it has no data
    out.emplace_back(leaf.name, must(std::move(value)));
  }
  return out;
}

Array Results::named(const std::string& name, const std::set<std::string>& ran) const {
  for (const std::string& step : ran)
    for (const std::string& output : names_.outputs(step))
      if (output == name || step + "." + output == name) return must(target_.output(step, output));
  return must(target_.leaf(name));
}

void Results::write_mesh(const std::string& file, const std::string& what, const std::set<std::string>& ran) const {
  std::vector<std::string> parts;
  std::map<std::string, std::string> material;
  std::stringstream text(what);
  for (std::string part; std::getline(text, part, ':');)
    if (const size_t equals = part.find('='); equals != std::string::npos)
      material[part.substr(0, equals)] = part.substr(equals + 1);
    else
      parts.push_back(part);
  if (parts.size() < 2 || parts.size() > 5)
    throw Mistake{"--mesh " + file + ": expected POSITION:FACE[:UV[:UV_FACE[:TEXTURE]]][:PART=NAME ...], found '" +
                  what + "'"};
  if (!material.empty() && file.ends_with(".obj"))
    throw Mistake{"--mesh " + file + ": an .obj file has no '" + material.begin()->first +
                  "', a .gltf or .glb file has"};
  if (parts.size() > 4) material["base_color_texture"] = parts[4];
  const auto array = [&](const std::string& name, int components, io::ElementKind kind, const char* type) {
    Array a = named(name, ran);
    // The reference computes in float64.
    if (a.components == components && a.kind == io::ElementKind::Float64) a = must(a.converted(kind));
    if (a.components != components || a.kind != kind)
      throw Mistake{"--mesh " + file + ": '" + name + "' is not made of " + type};
    return a;
  };
  using enum io::ElementKind;
  const Array position = array(parts[0], 3, Float32, "vec3"), face = array(parts[1], 3, Int32, "ivec3");
  const Array uv = parts.size() > 2 ? array(parts[2], 2, Float32, "vec2") : Array();
  const Array uv_face = parts.size() > 3 ? array(parts[3], 3, Int32, "ivec3") : Array();
  io::MeshView view{.positions = position.as<float>(), .indices = face.as<int32_t>()};
  if (!uv.empty()) view.uv = uv.as<float>();
  if (!uv_face.empty()) view.uv_indices = uv_face.as<int32_t>();
  MeshMaterial parts_of(file, material, [&](const std::string& name, int components) {
    return array(name, components, Float32, components == 1 ? "float" : "vec3");
  });
  parts_of.show(view);
  must(io::save_mesh(file, view));
}

}  // namespace dr::drun
