// SPDX-License-Identifier: Apache-2.0
// Results as files.
#include "runtime/drun/results.h"

#include <charconv>
#include <cstdio>
#include <filesystem>
#include <map>
#include <optional>
#include <sstream>

#include "runtime/io/mesh.h"

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
      if (a.scalar_count() == 1) continue;
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
      if (output == name) return must(target_.output(step, name));
  return must(target_.leaf(name));
}

void Results::write_mesh(const std::string& file, const std::string& what, const std::set<std::string>& ran) const {
  std::vector<std::string> parts;
  std::stringstream text(what);
  for (std::string part; std::getline(text, part, ':');) parts.push_back(part);
  if (parts.size() < 2 || parts.size() > 4)
    throw Mistake{"--mesh " + file + ": expected POSITION:FACE[:UV[:UV_FACE]], found '" + what + "'"};
  const Array positions = named(parts[0], ran), faces = named(parts[1], ran);
  if (positions.components != 3 || positions.kind != io::ElementKind::Float32)
    throw Mistake{"--mesh " + file + ": '" + parts[0] + "' is not made of vec3"};
  if (faces.components != 3 || faces.kind != io::ElementKind::Int32)
    throw Mistake{"--mesh " + file + ": '" + parts[1] + "' is not made of ivec3"};
  std::optional<Array> uv, uv_faces;
  if (parts.size() == 4) {
    uv_faces = named(parts[3], ran);
    if (uv_faces->components != 3 || uv_faces->kind != io::ElementKind::Int32)
      throw Mistake{"--mesh " + file + ": '" + parts[3] + "' is not made of ivec3"};
  }
  if (parts.size() >= 3) {
    uv = named(parts[2], ran);
    if (uv->components != 2 || uv->kind != io::ElementKind::Float32)
      throw Mistake{"--mesh " + file + ": '" + parts[2] + "' is not made of vec2"};
  }
  io::MeshView view{.positions = positions.as<float>(), .indices = faces.as<int32_t>()};
  if (uv) view.uv = uv->as<float>();
  if (uv_faces) view.uv_indices = uv_faces->as<int32_t>();
  must(io::save_mesh(file, view));
}

}  // namespace dr::drun
