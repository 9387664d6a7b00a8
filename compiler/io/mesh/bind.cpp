// SPDX-License-Identifier: Apache-2.0
// Attributes of triangles by their selector.
#include "compiler/io/mesh/bind.h"

#include <algorithm>
#include <vector>

#include "compiler/io/array/checked.h"
#include "compiler/io/file/failure.h"
#include "compiler/io/mesh/mesh_readers.h"
#include "compiler/io/mesh/strands.h"

namespace dr::io {
namespace {

struct Selector {
  std::string_view name;
  MeshAttribute attribute;
};
// The first kBoth are those of OBJ files, too.
constexpr Selector kSelectors[] = {{"position", MeshAttribute::Position},
                                   {"indices", MeshAttribute::Indices},
                                   {"uv", MeshAttribute::Uv},
                                   {"uv_indices", MeshAttribute::UvIndices},
                                   {"normal", MeshAttribute::Normal},
                                   {"color", MeshAttribute::Color},
                                   {"uv1", MeshAttribute::Uv1},
                                   {"tangent", MeshAttribute::Tangent},
                                   {"joints", MeshAttribute::Joints},
                                   {"weights", MeshAttribute::Weights},
                                   {"materials", MeshAttribute::Material}};
constexpr size_t kBoth = 6;

// ":position, :indices or :uv".
template <class Names>
std::string listed(const Names& names) {
  std::string list;
  for (size_t i = 0; i < names.size(); ++i) {
    append(list, cat(i == 0 ? "" : i + 1 == names.size() ? " or " : ", ", "':", names[i], "'"));
  }
  return list;
}

std::vector<std::string_view> selector_names(bool gltf) {
  std::vector<std::string_view> names;
  for (const Selector& selector : kSelectors) {
    if (gltf || names.size() < kBoth) names.push_back(selector.name);
  }
  if (gltf) {
    names.push_back("morph");
    names.push_back("lines");
    names.insert(names.end(), std::begin(kSceneKinds), std::end(kSceneKinds));
  }
  return names;
}

Array colors(const Mesh& mesh, int expected_components) {
  if (expected_components != 3) return Array::from_floats(mesh.colors, 4);
  std::vector<float> rgb;
  for (size_t i = 0; i < mesh.colors.size(); ++i) {
    if (i % 4 != 3)
      rgb.push_back(mesh.colors[i]);
    else if (mesh.colors[i] != 1)
      fail("its colours have an alpha other than 1, which 3 components cannot hold");
  }
  return Array::from_floats(rgb, 3);
}

// A row for each target.
Array morphs(const std::string& path, std::span<const std::string_view> words) {
  if (words.size() != 1 || (words[0] != "position" && words[0] != "normal")) {
    fail("a morph target takes ':morph:position' or ':morph:normal'");
  }
  const bool normals = words[0] == "normal";
  const Mesh mesh = read_mesh(path, normals ? MeshAttribute::MorphNormal : MeshAttribute::MorphPosition);
  const auto count = static_cast<int64_t>(mesh.morphs.size());
  Array array = checked_zeros(ElementKind::Float32, 3, mesh.vertex_count(), count, 1);
  auto out = array.as<float>().begin();
  for (const Mesh::Morph& morph : mesh.morphs) {
    // A target that says nothing of normals leaves them alone.
    const std::vector<float>& deltas = normals ? morph.normals : morph.positions;
    std::copy(deltas.begin(), deltas.end(), out);
    out += mesh.vertex_count() * 3;
  }
  return array;
}

}  // namespace

Array bind_mesh(const std::string& path, std::span<const std::string_view> selectors, int expected_components) {
  const bool gltf = extension_of(path) != ".obj";
  if (selectors.empty()) fail("say which part of the mesh: add ", listed(selector_names(gltf)));
  const std::string_view selector = selectors.front();
  if (gltf && selector == "morph") return morphs(path, selectors.subspan(1));
  if (gltf && selector == "lines") return bind_strands(path, selectors.subspan(1));
  if (gltf && std::ranges::find(kSceneKinds, selector) != std::end(kSceneKinds)) {
    return bind_scene(path, selectors, expected_components);
  }
  if (selectors.size() > 1) fail("one selector is enough for a mesh, found ", selectors.size());
  const auto names = selector_names(gltf);
  const auto* found = std::find_if(std::begin(kSelectors), std::end(kSelectors),
                                   [&](const Selector& entry) { return entry.name == selector; });
  const bool known = found != std::end(kSelectors) && (gltf || found < std::begin(kSelectors) + kBoth);
  if (!known) {
    const std::string hint = did_you_mean(selector, names);
    fail("unknown selector ", in_quotes(selector), hint.empty() ? cat(", expected ", listed(names)) : hint);
  }
  const Mesh mesh = read_mesh(path, found->attribute);
  switch (found->attribute) {
    case MeshAttribute::Position: return Array::from_floats(mesh.positions, 3);
    case MeshAttribute::Indices: return Array::from_ints(mesh.indices, 3);
    case MeshAttribute::Uv: return Array::from_floats(mesh.uv, 2);
    case MeshAttribute::UvIndices: return Array::from_ints(mesh.uv_indices, 3);
    case MeshAttribute::Normal: return Array::from_floats(mesh.normals, 3);
    case MeshAttribute::Color: return colors(mesh, expected_components);
    case MeshAttribute::Uv1: return Array::from_floats(mesh.uv1, 2);
    case MeshAttribute::Tangent: return Array::from_floats(mesh.tangents, 4);
    case MeshAttribute::Joints: return Array::from_ints(mesh.joints, 4);
    case MeshAttribute::Weights: return Array::from_floats(mesh.weights, 4);
    case MeshAttribute::Material: break;
    case MeshAttribute::MorphPosition:
    case MeshAttribute::MorphNormal: return {};  // not by one word
  }
  if (mesh.materials.empty()) fail("no triangle has a material");
  return Array::from_ints(mesh.materials, 1);
}

}  // namespace dr::io
