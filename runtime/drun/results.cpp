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

namespace dr::drun {

using io::Array;

namespace {

std::vector<std::string> mesh_parts(const std::string& file, const std::string& what) {
  std::vector<std::string> parts;
  std::stringstream text(what);
  for (std::string part; std::getline(text, part, ':');) parts.push_back(part);
  if (parts.size() < 2 || parts.size() > 5)
    throw Mistake{"--mesh " + file + ": expected POSITION:FACE[:UV[:UV_FACE[:TEXTURE]]], found '" + what + "'"};
  return parts;
}

}  // namespace

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

void Results::check_mesh(const std::string& file, const std::string& what, const std::set<std::string>& steps) const {
  const std::vector<std::string> parts = mesh_parts(file, what);
  if (const std::string& ending = file.substr(std::min(file.rfind('.'), file.size()));
      ending != ".obj" && ending != ".gltf" && ending != ".glb")
    throw Mistake{"--mesh " + file + ": expected a name that ends in .obj, .gltf or .glb"};
  std::set<std::string> known;
  std::string all;
  for (const auto& leaf : names_.leaves()) known.insert(leaf.name);
  for (const std::string& step : steps)
    for (const std::string& output : names_.outputs(step)) known.insert({output, step + "." + output});
  for (const std::string& name : known) all += (all.empty() ? "" : ", ") + name;
  for (const std::string& part : parts)
    if (!known.contains(part))
      throw Mistake{"--mesh " + file + ": there is no leaf or output '" + part + "'; there are " + all};
}

void Results::write_mesh(const std::string& file, const std::string& what, const std::set<std::string>& ran) const {
  const std::vector<std::string> parts = mesh_parts(file, what);
  std::vector<Array> arrays;
  for (const std::string& part : parts) arrays.push_back(named(part, ran));
  auto expect = [&](size_t k, int components, io::ElementKind kind, const char* type) {
    if (k >= arrays.size()) return;
    // The reference computes in float64.
    if (arrays[k].components == components && arrays[k].kind == io::ElementKind::Float64)
      arrays[k] = must(arrays[k].converted(kind));
    if (arrays[k].components != components || arrays[k].kind != kind)
      throw Mistake{"--mesh " + file + ": '" + parts[k] + "' is not made of " + type};
  };
  using enum io::ElementKind;
  expect(0, 3, Float32, "vec3");
  expect(1, 3, Int32, "ivec3");
  expect(2, 2, Float32, "vec2");
  expect(3, 3, Int32, "ivec3");
  expect(4, 3, Float32, "vec3");
  io::MeshView view{.positions = arrays[0].as<float>(), .indices = arrays[1].as<int32_t>()};
  if (arrays.size() > 2) view.uv = arrays[2].as<float>();
  if (arrays.size() > 3) view.uv_indices = arrays[3].as<int32_t>();
  if (arrays.size() > 4) view.texture = &arrays[4];
  must(io::save_mesh(file, view));
}

}  // namespace dr::drun
