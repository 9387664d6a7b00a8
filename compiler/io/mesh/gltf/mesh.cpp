// SPDX-License-Identifier: Apache-2.0
// The triangles of a glTF file, as one mesh.

#include <algorithm>
#include <cmath>
#include <glm/gtc/type_ptr.hpp>
#include <glm/matrix.hpp>
#include <unordered_map>

#include "compiler/io/file/failure.h"
#include "compiler/io/mesh/gltf/accessors.h"
#include "compiler/io/mesh/gltf/document.h"
#include "compiler/io/mesh/gltf/transform.h"
#include "compiler/io/mesh/mesh_readers.h"

namespace dr::io {
namespace gltf {
namespace {

// The most vertices of all morph targets together.
constexpr uint64_t kMaxMorphVertices = uint64_t{1} << 26;

// A primitive in its mesh's own space: read once, however many nodes use it.
struct Part {
  std::vector<float> positions, uv, uv1, normals, tangents, colors, weights;
  std::vector<int32_t> joints;
  std::vector<Mesh::Morph> morphs;
  std::vector<uint32_t> triangles;  // corners in the part's own numbers
  int material = -1;
  std::string where;

  size_t vertex_count() const { return positions.size() / 3; }
};

// Three corners of each triangle, out of a list, a strip or a fan.
std::vector<uint32_t> triangles_of(const std::vector<uint32_t>& order, uint64_t mode, const std::string& where) {
  if (mode == kTriangles && order.size() % 3 != 0) {
    fail(where, ": ", order.size(), " indices are not a multiple of 3");
  }
  if (order.size() < 3) fail(where, ": ", order.size(), " indices make no triangle");
  if (mode == kTriangles) return order;
  std::vector<uint32_t> corners;
  corners.reserve((order.size() - 2) * 3);
  for (size_t t = 0; t + 2 < order.size(); ++t) {
    size_t a = t;
    size_t b = t + 1;
    size_t c = t + 2;
    if (mode == kStrip && t % 2 == 1) std::swap(b, c);  // every other triangle of a strip is wound the other way
    if (mode == kFan) {
      // The specification's order: the hub comes last.
      a = t + 1;
      b = t + 2;
      c = 0;
    }
    for (const size_t corner : {a, b, c}) corners.push_back(order[corner]);
  }
  return corners;
}

class MeshReader {
 public:
  MeshReader(const Document& document, RequiredAttribute required) : document_(document), required_(required) {}

  Mesh read() {
    if (document_.model.nodes.empty() && document_.model.scenes.empty()) {
      // A bare library of meshes: take them as they are.
      for (size_t i = 0; i < document_.model.meshes.size(); ++i) add_mesh(static_cast<int>(i), glm::dmat4(1.0), -1);
    }
    for (const PlacedNode& placed : placed_nodes(document_)) {
      const tinygltf::Node& node = document_.model.nodes[static_cast<size_t>(placed.node)];
      if (node.mesh >= 0) add_mesh(node.mesh, node.skin >= 0 ? glm::dmat4(1.0) : placed.world, node.skin);
    }
    if (mesh_.indices.empty()) fail(no_triangles_.empty() ? "the scene has no triangles" : no_triangles_);
    if (!lacks_.empty() && !has_required()) fail(lacks_);
    drop_what_some_lack();
    return std::move(mesh_);
  }

 private:
  static constexpr auto kVertexLimit = static_cast<uint64_t>(kMaxVertices);

  // Whether an attribute is to be read: all are, where none is named, and what every mesh has is always checked.
  bool wants(MeshAttribute attribute) const {
    return !required_ || required_ == attribute || attribute <= MeshAttribute::Color;
  }

  // Reading a primitive.

  const std::vector<Part>& parts_of(int mesh) {
    const auto [entry, fresh] = parts_.try_emplace(mesh);
    if (!fresh) return entry->second;
    const std::vector<tinygltf::Primitive>& primitives = document_.model.meshes[static_cast<size_t>(mesh)].primitives;
    entry->second.reserve(primitives.size());
    for (size_t i = 0; i < primitives.size(); ++i) {
      const std::string where = cat("meshes[", mesh, "].primitives[", i, "]");
      if (const int mode = primitives[i].mode; mode >= static_cast<int>(kTriangles)) {
        entry->second.push_back(read_part(primitives[i], where));
      } else if (no_triangles_.empty()) {
        no_triangles_ =
            cat(where, ".mode: ", mode, " is points or lines, only triangles are read; ':lines' reads lines");
      }
    }
    return entry->second;
  }

  Part read_part(const tinygltf::Primitive& primitive, const std::string& where) {
    Part part;
    part.where = where;
    part.material = primitive.material;
    if (!primitive.attributes.contains("POSITION")) fail(where, ": there is no POSITION");
    part.positions = attribute(primitive, where, "POSITION", {3, 3}).values;
    const uint64_t count = part.vertex_count();
    const auto optional = [&](MeshAttribute wanted, const char* name, const Expected& expected) {
      return wanted_attribute(primitive, where, wanted, name, expected);
    };
    const bool uv = required_ != MeshAttribute::UvIndices;
    part.uv = optional(uv ? MeshAttribute::Uv : MeshAttribute::UvIndices, "TEXCOORD_0",
                       {2, 2, Integers::NormalizedUnsigned, count})
                  .values;
    part.uv1 = optional(MeshAttribute::Uv1, "TEXCOORD_1", {2, 2, Integers::NormalizedUnsigned, count}).values;
    part.normals = optional(MeshAttribute::Normal, "NORMAL", {3, 3, Integers::None, count}).values;
    part.tangents = optional(MeshAttribute::Tangent, "TANGENT", {4, 4, Integers::None, count}).values;
    read_weights(primitive, part);
    read_colors(optional(MeshAttribute::Color, "COLOR_0", {3, 4, Integers::NormalizedUnsigned, count}), part);
    read_joints(primitive, part);
    read_morphs(primitive, part);
    part.triangles =
        triangles_of(read_order(document_, primitive, count, where), static_cast<uint64_t>(primitive.mode), where);
    return part;
  }

  Floats attribute(const tinygltf::Primitive& primitive, const std::string& where, const char* name,
                   const Expected& expected) const {
    const auto index = static_cast<uint64_t>(primitive.attributes.at(name));
    return read_floats(document_, index, expected, kVertexLimit, cat(where, ".attributes.", name));
  }

  Floats wanted_attribute(const tinygltf::Primitive& primitive, const std::string& where, MeshAttribute wanted,
                          const char* name, const Expected& expected) {
    if (!wants(wanted)) return {};
    if (primitive.attributes.contains(name)) return attribute(primitive, where, name, expected);
    misses(where, wanted, name);
    return {};
  }

  void misses(const std::string& where, MeshAttribute wanted, const char* name) {
    if (required_ == wanted) lack(cat(where, ": there is no ", name), wanted);
  }

  // A primitive lacks what is asked for. Where another one has it, some attributes are as if it were not there.
  void lack(std::string why, MeshAttribute attribute) {
    using enum MeshAttribute;
    if (attribute != Color && attribute != Weights && attribute != Joints && attribute != MorphPosition &&
        attribute != MorphNormal)
      fail(why);
    if (lacks_.empty()) lacks_ = std::move(why);
  }

  // Of those attributes: whether some primitive has the one that is asked for.
  bool has_required() const {
    switch (*required_) {
      case MeshAttribute::Color: return !mesh_.colors.empty();
      case MeshAttribute::Weights: return !mesh_.weights.empty();
      case MeshAttribute::Joints: return !mesh_.joints.empty();
      default: return !mesh_.morphs.empty();
    }
  }

  static void read_colors(Floats colors, Part& part) {
    if (colors.components == 4) {
      part.colors = std::move(colors.values);
      return;
    }
    for (size_t i = 0; i < colors.values.size(); ++i) {
      part.colors.push_back(colors.values[i]);
      if (i % 3 == 2) part.colors.push_back(1.0f);  // no alpha
    }
  }

  // Joints that weigh something are looked at more closely, so they want weights, too.
  void read_weights(const tinygltf::Primitive& primitive, Part& part) {
    if (!wants(MeshAttribute::Weights) && !wants(MeshAttribute::Joints)) return;
    const Expected expected{4, 4, Integers::NormalizedUnsigned, part.vertex_count()};
    if (primitive.attributes.contains("WEIGHTS_0"))
      part.weights = attribute(primitive, part.where, "WEIGHTS_0", expected).values;
    else
      misses(part.where, MeshAttribute::Weights, "WEIGHTS_0");
    if (!primitive.attributes.contains("WEIGHTS_1")) return;
    const std::vector<float> more = attribute(primitive, part.where, "WEIGHTS_1", expected).values;
    const auto weighs = std::ranges::find_if(more, [](float weight) { return weight != 0; });
    if (weighs != more.end())
      fail(part.where, ".attributes.WEIGHTS_1: element ", (weighs - more.begin()) / 4,
           " has more than four joints, of which four are read");
  }

  void read_joints(const tinygltf::Primitive& primitive, Part& part) {
    if (!wants(MeshAttribute::Joints)) return;
    const auto found = primitive.attributes.find("JOINTS_0");
    if (found == primitive.attributes.end()) return misses(part.where, MeshAttribute::Joints, "JOINTS_0");
    const std::string where = cat(part.where, ".attributes.JOINTS_0");
    const Elements joints = read_elements(document_, static_cast<uint64_t>(found->second), kVertexLimit);
    if (joints.components != 4 || (joints.component_type != kUByte && joints.component_type != kUShort)) {
      fail(where, ": expected 4 unsigned integers of 8 or 16 bits, found ", joints.components, " x component type ",
           joints.component_type);
    }
    if (joints.count != part.vertex_count()) {
      fail(where, ": ", joints.count, " elements, but POSITION has ", part.vertex_count());
    }
    part.joints.resize(part.vertex_count() * 4);
    for (size_t i = 0; i < part.joints.size(); ++i) part.joints[i] = static_cast<int32_t>(unsigned_at(joints, i));
  }

  void read_morphs(const tinygltf::Primitive& primitive, Part& part) {
    const bool positions = wants(MeshAttribute::MorphPosition);
    const bool normals = wants(MeshAttribute::MorphNormal);
    if (!positions && !normals) return;
    if (required_ && primitive.targets.empty()) lack(cat(part.where, ": there are no morph targets"), *required_);
    for (size_t k = 0; k < primitive.targets.size(); ++k) {
      const auto& target = primitive.targets[k];
      const auto deltas = [&](bool wanted, const char* name) -> std::vector<float> {
        const auto found = target.find(name);
        if (!wanted || found == target.end()) return {};
        const std::string where = cat(part.where, ".targets[", k, "].", name);
        return read_floats(document_, static_cast<uint64_t>(found->second), {3, 3, Integers::None, part.vertex_count()},
                           kVertexLimit, where)
            .values;
      };
      part.morphs.push_back({deltas(positions, "POSITION"), deltas(normals, "NORMAL")});
      if (!part.morphs.back().normals.empty() && part.normals.empty()) {
        fail(part.where, ".targets[", k, "].NORMAL: the primitive has no NORMAL to add it to");
      }
    }
  }

  // Placing it.

  void add_mesh(int mesh, const glm::dmat4& transform, int skin) {
    for (const Part& part : parts_of(mesh)) add_part(part, transform, skin);
  }

  void add_part(const Part& part, const glm::dmat4& transform, int skin) {
    const size_t base = mesh_.positions.size() / 3;
    const size_t count = part.vertex_count();
    if (base + count > kVertexLimit) fail("the scene has more than ", kMaxVertices, " vertices");
    if (mesh_.indices.size() / 3 + part.triangles.size() / 3 > static_cast<size_t>(kMaxTriangles)) {
      fail("the scene has more than ", kMaxTriangles, " triangles");
    }
    const bool mirrored = glm::determinant(glm::dmat3(transform)) < 0;
    add_positions(part, transform);
    add_all(mesh_.uv, part.uv);
    add_all(mesh_.uv1, part.uv1);
    add_normals(part, transform);
    add_tangents(part, transform, mirrored);
    // What a vertex lacks is as if it were not there: a factor of 1, weights of 0.
    add_or_fill(mesh_.colors, part.colors, base, count, 4, 1.0f);
    add_weights(part, skin, base, count);
    add_joints(part, skin, base, count);
    add_morphs(part, transform, base, count);
    for (size_t i = 0; i < part.triangles.size(); i += 3) {
      const size_t b = mirrored ? 2 : 1;
      for (const size_t corner : {i, i + b, i + 3 - b}) {
        mesh_.indices.push_back(static_cast<int32_t>(base + part.triangles[corner]));
      }
    }
    if (wants(MeshAttribute::Material)) {
      mesh_.materials.insert(mesh_.materials.end(), part.triangles.size() / 3, part.material);
      any_has_material_ = any_has_material_ || part.material >= 0;
    }
  }

  template <class T>
  static void add_all(std::vector<T>& all, const std::vector<T>& values) {
    all.insert(all.end(), values.begin(), values.end());
  }

  // Values of a part that all parts get as soon as one has them.
  template <class T>
  static void add_or_fill(std::vector<T>& all, const std::vector<T>& values, size_t base, size_t count,
                          size_t components, T missing) {
    if (all.empty() && values.empty()) return;
    all.resize(base * components, missing);
    add_all(all, values);
    all.resize((base + count) * components, missing);
  }

  void add_positions(const Part& part, const glm::dmat4& transform) {
    if (transform == glm::dmat4(1.0)) return add_all(mesh_.positions, part.positions);  // the very bits of the file
    for (size_t i = 0; i < part.positions.size() / 3; ++i) {
      add_placed(mesh_.positions, transform, &part.positions[3 * i], i, part.where);
    }
  }

  // At unit length; what has no direction becomes `otherwise`.
  static void add_direction(std::vector<float>& all, const glm::dvec3& direction, const glm::vec3& otherwise) {
    const double length = std::hypot(direction.x, direction.y, direction.z);
    const bool usable = length > 0 && std::isfinite(length);
    for (int k = 0; k < 3; ++k) all.push_back(usable ? static_cast<float>(direction[k] / length) : otherwise[k]);
  }

  void add_normals(const Part& part, const glm::dmat4& transform) {
    for (size_t i = 0; i < part.normals.size(); i += 3) {
      const glm::dvec3 normal(glm::make_vec3(&part.normals[i]));
      add_direction(mesh_.normals, transformed_normal(transform, normal), {0, 0, 1});
    }
  }

  // A mirror turns the bitangent, which is the cross product of a normal and a tangent, the other way.
  void add_tangents(const Part& part, const glm::dmat4& transform, bool mirrored) {
    for (size_t i = 0; i < part.tangents.size(); i += 4) {
      const glm::dvec3 tangent(glm::make_vec3(&part.tangents[i]));
      add_direction(mesh_.tangents, glm::dmat3(transform) * tangent, {1, 0, 0});
      mesh_.tangents.push_back((part.tangents[i + 3] < 0) != mirrored ? -1.0f : 1.0f);
    }
  }

  // A node without a skin moves its mesh as a whole, whatever its vertices weigh elsewhere.
  void add_weights(const Part& part, int skin, size_t base, size_t count) {
    if (!wants(MeshAttribute::Weights)) return;
    const std::vector<float> none(part.weights.size());
    add_or_fill(mesh_.weights, skin < 0 ? none : part.weights, base, count, 4, 0.0f);
  }

  void add_joints(const Part& part, int skin, size_t base, size_t count) {
    const std::vector<tinygltf::Skin>& skins = document_.model.skins;
    const size_t of_skin = skin < 0 ? 0 : skins[static_cast<size_t>(skin)].joints.size();
    size_t before = 0;
    for (int s = 0; s < skin; ++s) before += skins[static_cast<size_t>(s)].joints.size();
    std::vector<int32_t> joints = part.joints;
    for (size_t i = 0; i < joints.size(); ++i) {
      if (static_cast<size_t>(joints[i]) >= of_skin) {
        // A mesh without a skin has joints for nothing, and those that weigh nothing may be anything.
        const bool weighs = skin >= 0 && i < part.weights.size() && part.weights[i] != 0;
        if (weighs) {
          fail(part.where, ".attributes.JOINTS_0: element ", i / 4, " names joint ", joints[i], ", skins[", skin,
               "] has ", of_skin);
        }
        joints[i] = 0;
      }
      joints[i] += static_cast<int32_t>(before);
    }
    add_or_fill(mesh_.joints, joints, base, count, 4, 0);
  }

  void add_morphs(const Part& part, const glm::dmat4& transform, size_t base, size_t count) {
    const size_t targets = std::max(mesh_.morphs.size(), part.morphs.size());
    if ((base + count) * targets > kMaxMorphVertices) {
      fail("the morph targets have more than ", kMaxMorphVertices, " vertices together");
    }
    mesh_.morphs.resize(targets);
    for (size_t k = 0; k < targets; ++k) {
      static const Mesh::Morph kNone;
      const Mesh::Morph& deltas = k < part.morphs.size() ? part.morphs[k] : kNone;
      std::vector<float> positions = deltas.positions;
      std::vector<float> normals = deltas.normals;
      if (transform != glm::dmat4(1.0)) {
        for (size_t i = 0; i < positions.size(); i += 3) {
          replace(positions, i, glm::dmat3(transform) * glm::dvec3(glm::make_vec3(&positions[i])));
        }
        // By what the normal itself is divided by, so that their sum is the sum's transform.
        for (size_t i = 0; i < normals.size() && i < part.normals.size(); i += 3) {
          const double length = glm::length(transformed_normal(transform, glm::make_vec3(&part.normals[i])));
          const glm::dvec3 moved = transformed_normal(transform, glm::make_vec3(&normals[i]));
          replace(normals, i, length > 0 ? moved / length : moved);
        }
      }
      add_or_fill(mesh_.morphs[k].positions, positions, base, count, 3, 0.0f);
      add_or_fill(mesh_.morphs[k].normals, normals, base, count, 3, 0.0f);
    }
  }

  static void replace(std::vector<float>& values, size_t at, const glm::dvec3& by) {
    for (int k = 0; k < 3; ++k) values[at + static_cast<size_t>(k)] = static_cast<float>(by[k]);
  }

  // An attribute of vertices that some parts have and others have not is left out.
  void drop_what_some_lack() {
    const size_t count = mesh_.positions.size() / 3;
    const auto keep_if_all = [&](std::vector<float>& values, size_t components) {
      if (values.size() != count * components) values.clear();
    };
    keep_if_all(mesh_.uv, 2);
    keep_if_all(mesh_.uv1, 2);
    keep_if_all(mesh_.normals, 3);
    keep_if_all(mesh_.tangents, 4);
    if (!mesh_.uv.empty()) mesh_.uv_indices = mesh_.indices;
    if (!any_has_material_) mesh_.materials.clear();
  }

  const Document& document_;
  const RequiredAttribute required_;
  std::unordered_map<int, std::vector<Part>> parts_;
  Mesh mesh_;
  bool any_has_material_ = false;
  std::string no_triangles_;  // the first primitive of points or lines, as a sentence
  std::string lacks_;         // the first one without what is asked for, likewise
};

}  // namespace
}  // namespace gltf

Mesh parse_gltf(std::span<const uint8_t> content, const std::string& path, RequiredAttribute required) {
  return gltf::MeshReader(gltf::load_document(content, path), required).read();
}

}  // namespace dr::io
