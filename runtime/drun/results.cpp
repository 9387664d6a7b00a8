// SPDX-License-Identifier: Apache-2.0
// Results as files.
#include "runtime/drun/results.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <map>
#include <optional>
#include <sstream>

#include "compiler/io/mesh/mesh.h"
#include "runtime/drun/mesh_material.h"

namespace dr::drun {

using io::Array;

namespace {

// What --mesh asks for: POSITION, FACE, UV, UV_FACE, and parts of a material by name.
struct MeshParts {
  std::vector<std::string> names;
  std::map<std::string, std::string> material;
};

MeshParts parse_mesh(const std::string& file, const std::string& what, const std::string& out_folder = "") {
  constexpr std::string_view kExtensions[] = {".obj", ".gltf", ".glb"};
  if (const auto checked = io::check_output_file(file, kExtensions, out_folder); !checked)
    throw Mistake{"--mesh: " + checked.error()};
  MeshParts out;
  std::stringstream text(what);
  for (std::string part; std::getline(text, part, ':');)
    if (const size_t equals = part.find('='); equals != std::string::npos)
      out.material[part.substr(0, equals)] = part.substr(equals + 1);
    else
      out.names.push_back(part);
  if (out.names.size() < 2 || out.names.size() > 5)
    throw Mistake{"--mesh " + file + ": expected POSITION:FACE[:UV[:UV_FACE[:TEXTURE]]][:PART=NAME ...], found '" +
                  what + "'"};
  if (!out.material.empty() && file.ends_with(".obj"))
    throw Mistake{"--mesh " + file + ": an .obj file has no '" + out.material.begin()->first +
                  "', a .gltf or .glb file has"};
  if (out.names.size() > 4) out.material["base_color_texture"] = out.names[4];
  const auto is_texture = [](const auto& part) { return part.first.ends_with("_texture"); };
  if (out.names.size() < 3 && std::ranges::any_of(out.material, is_texture))
    throw Mistake{"--mesh " + file + ": there is a texture but no uv, expected POSITION:FACE:UV, found '" + what + "'"};
  if (out.names.size() > 4 && file.ends_with(".obj"))
    if (const auto checked = io::check_material_file(file); !checked) throw Mistake{"--mesh: " + checked.error()};
  return out;
}

struct Corner {
  int components;
  io::ElementKind kind;
  const char* type;
};
constexpr Corner kCorners[] = {{3, io::ElementKind::Float32, "vec3"},
                               {3, io::ElementKind::Int32, "ivec3"},
                               {2, io::ElementKind::Float32, "vec2"},
                               {3, io::ElementKind::Int32, "ivec3"}};

std::vector<std::string> results_in(const MeshParts& parts) {
  std::vector<std::string> out = parts.names;
  for (const auto& [part, name] : parts.material) out.push_back(name);
  return out;
}

Mistake wrong_type(const std::string& file, const std::string& name, const char* type) {
  return Mistake{"--mesh " + file + ": '" + name + "' is not made of " + type};
}

}  // namespace

std::string number_text(double value, bool whole) {
  if (std::isnan(value)) return "nan";  // whatever its sign
  char text[32];
  char* const end = whole ? std::to_chars(text, text + sizeof text, value).ptr
                          : std::to_chars(text, text + sizeof text, static_cast<float>(value)).ptr;
  return {text, end};
}

io::ResultNames Results::names_of(const std::set<std::string>& steps) const {
  io::ResultNames out;
  for (const std::string& step : steps) out.steps.emplace_back(step, names_.outputs(step));
  for (const auto& leaf : names_.leaves()) out.leaves.push_back(leaf.name);
  return out;
}

io::ResultName Results::found(const std::string& name, const std::set<std::string>& steps) const {
  return must(io::find_result(name, names_of(steps)));
}

runtime::Program::LeafInfo Results::info(const io::ResultName& name) const {
  if (!name.step.empty()) return names_.output_info(name.step, name.name);
  for (const auto& leaf : names_.leaves())
    if (leaf.name == name.name) return leaf;
  throw Mistake{"there is no leaf '" + name.name + "'"};
}

void Results::check(const Options& options, const std::set<std::string>& steps) const {
  if (!options.out.empty())
    if (const auto shared = io::shared_name(names_of(steps))) throw Mistake{*shared};
  std::set<std::filesystem::path> files;
  const auto place = [](const std::string& file) {
    std::error_code error;
    const auto path = std::filesystem::weakly_canonical(std::filesystem::absolute(file, error), error);
    return error ? std::filesystem::path(file) : path;
  };
  const auto once = [&](const char* option, const std::string& file) {
    if (!files.insert(place(file)).second)
      throw Mistake{std::string(option) + ": '" + file + "' is to be written twice"};
  };
  if (!options.out.empty()) {
    const auto in_out = [&](const std::string& name) { files.insert(place(options.out + "/" + name)); };
    for (const std::string& step : steps)
      for (const std::string& output : names_.outputs(step))
        for (const char* ending : {".npy", ".png"}) in_out(io::ResultName{step, output}.str() + ending);
    for (const auto& leaf : names_.leaves()) in_out(leaf.name + ".npy");
    for (const char* own : {"results.txt", "log.jsonl", "checkpoint.json"}) in_out(own);
  }
  for (const auto& [name, file] : options.saves) {
    once("--save", file);
    const auto what = io::find_result(name, names_of(steps));
    if (!what) throw Mistake{"--save " + name + "=" + file + ": " + what.error()};
    const auto type = info(*what);
    must(io::check_saved(file, type.kind, type.components, options.out));
  }
  for (const auto& [file, text] : options.meshes) {
    once("--mesh", file);
    const MeshParts parts = parse_mesh(file, text, options.out);
    for (size_t k = 0; k < std::min<size_t>(parts.names.size(), 4); ++k) {
      const auto what = io::find_result(parts.names[k], names_of(steps));
      if (!what) throw Mistake{"--mesh " + file + ": " + what.error()};
      const auto type = info(*what);
      if (type.components != kCorners[k].components || type.kind != kCorners[k].kind)
        throw wrong_type(file, parts.names[k], kCorners[k].type);
    }
    for (const auto& [part, name] : parts.material) {
      const int components = MeshMaterial::components_of(file, part);
      const auto what = io::find_result(name, names_of(steps));
      if (!what) throw Mistake{"--mesh " + file + ": " + what.error()};
      const auto type = info(*what);
      if (type.components != components || type.kind != io::ElementKind::Float32)
        throw wrong_type(file, name, components == 1 ? "float" : "vec3");
    }
  }
}

void Results::write_outputs(const std::string& folder, const std::set<std::string>& ran,
                            const std::vector<std::pair<std::string, Array>>& leaves, bool keep) const {
  io::ResultsFolder out(folder);
  for (const std::string& step : ran)
    for (const std::string& name : names_.outputs(step)) out.add({step, name}, written(step, name));
  for (const auto& [leaf, data] : leaves) out.add({"", leaf}, data);
  for (const std::string& warning : out.warnings()) std::fprintf(stderr, "drun: warning: %s\n", warning.c_str());
  must(out.finish(keep));
}

Array Results::output(const std::string& step, const std::string& name) const {
  if (const auto held = held_.find(step); held != held_.end())
    for (const auto& [known, data] : held->second)
      if (known == name) return data;
  return must(target_.output(step, name));
}

Array Results::written(const std::string& step, const std::string& name) const {
  Array data = output(step, name);
  if (look_) look_({step, name}, data);
  return data;
}

Outputs Results::outputs(const std::string& step) const {
  Outputs out;
  for (const std::string& name : names_.outputs(step)) out.emplace_back(name, output(step, name));
  return out;
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
  const io::ResultName what = found(name, ran);
  return what.step.empty() ? must(target_.leaf(what.name)) : written(what.step, what.name);
}

// Each is written, whatever becomes of the others; the first mistake is told.
void Results::write_asked(const Options& options, const std::set<std::string>& ran, bool stopped) const {
  const auto is_there = [&](const char* option, const std::string& file, const std::vector<std::string>& names) {
    const auto missing = std::ranges::find_if(
        names, [&](const std::string& name) { return !static_cast<bool>(io::find_result(name, names_of(ran))); });
    if (!stopped || missing == names.end()) return true;
    std::fprintf(stderr, "drun: warning: %s: '%s' is not written, as the step of '%s' has not run\n", option,
                 file.c_str(), missing->c_str());
    return false;
  };
  std::optional<Mistake> first;
  const auto attempt = [&](const auto& write) {
    try {
      write();
    } catch (const Mistake& mistake) {
      if (!first) first = mistake;
    }
  };
  for (const auto& [name, file] : options.saves)
    if (is_there("--save", file, {name}))
      attempt([&, &name = name, &file = file] { must(io::save_array(file, named(name, ran))); });
  for (const auto& [file, what] : options.meshes)
    attempt([&, &file = file, &what = what] {
      if (is_there("--mesh", file, results_in(parse_mesh(file, what)))) write_mesh(file, what, ran);
    });
  if (first) throw *first;
}

void Results::write_mesh(const std::string& file, const std::string& what, const std::set<std::string>& ran) const {
  const MeshParts parts = parse_mesh(file, what);
  const auto array = [&](const std::string& name, const Corner& corner) {
    Array a = named(name, ran);
    // The reference computes in float64.
    if (a.components == corner.components && a.kind == io::ElementKind::Float64) a = must(a.converted(corner.kind));
    if (a.components != corner.components || a.kind != corner.kind) throw wrong_type(file, name, corner.type);
    return a;
  };
  Array corners[4];
  for (size_t k = 0; k < std::min<size_t>(parts.names.size(), 4); ++k) corners[k] = array(parts.names[k], kCorners[k]);
  io::MeshView view{.positions = corners[0].as<float>(), .indices = corners[1].as<int32_t>()};
  if (!corners[2].empty()) view.uv = corners[2].as<float>();
  if (!corners[3].empty()) view.uv_indices = corners[3].as<int32_t>();
  MeshMaterial parts_of(file, parts.material, [&](const std::string& name, int components) {
    return array(name, {components, io::ElementKind::Float32, components == 1 ? "float" : "vec3"});
  });
  parts_of.show(view);
  must(io::save_mesh(file, view));
}

}  // namespace dr::drun
