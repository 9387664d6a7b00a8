// SPDX-License-Identifier: Apache-2.0
#include "compiler/io/mesh/gltf/transform.h"

#include <cmath>
#include <glm/ext/matrix_transform.hpp>
#include <glm/gtc/quaternion.hpp>
#include <glm/gtc/type_ptr.hpp>
#include <glm/matrix.hpp>

#include "compiler/io/file/failure.h"

namespace dr::io::gltf {
namespace {

std::vector<int> without_parent(const tinygltf::Model& model) {
  std::vector<bool> has_parent(model.nodes.size());
  for (const tinygltf::Node& node : model.nodes) {
    for (const int child : node.children) has_parent[static_cast<size_t>(child)] = true;
  }
  std::vector<int> roots;
  for (size_t i = 0; i < model.nodes.size(); ++i) {
    if (!has_parent[i]) roots.push_back(static_cast<int>(i));
  }
  return roots;
}

// Adds the trees of `roots` to `placed`, but for roots that are there already.
void place(const std::vector<tinygltf::Node>& nodes, const std::vector<int>& roots, std::vector<PlacedNode>& placed) {
  std::vector<bool> seen(nodes.size());
  for (const PlacedNode& node : placed) seen[static_cast<size_t>(node.node)] = true;
  std::vector<PlacedNode> stack;
  for (auto it = roots.rbegin(); it != roots.rend(); ++it) {
    if (!seen[static_cast<size_t>(*it)]) stack.push_back({*it, -1, glm::dmat4(1.0)});
  }
  while (!stack.empty()) {
    PlacedNode entry = stack.back();
    stack.pop_back();
    const auto at = static_cast<size_t>(entry.node);
    // A node has one parent at most, so that a second visit means a cycle or a shared child.
    if (seen[at]) fail("nodes[", entry.node, "]: it is reached twice, nodes must form a tree");
    seen[at] = true;
    entry.world = entry.world * local_transform(nodes[at]);
    const std::vector<int>& children = nodes[at].children;
    for (auto it = children.rbegin(); it != children.rend(); ++it) stack.push_back({*it, entry.node, entry.world});
    placed.push_back(entry);
  }
}

}  // namespace

glm::dmat4 local_transform(const tinygltf::Node& node) {
  if (!node.matrix.empty()) return glm::make_mat4(node.matrix.data());
  glm::dmat4 result(1.0);
  if (!node.translation.empty()) result = glm::translate(result, glm::make_vec3(node.translation.data()));
  if (!node.rotation.empty()) {
    const std::vector<double>& q = node.rotation;
    result *= glm::mat4_cast(glm::normalize(glm::dquat(q[3], q[0], q[1], q[2])));
  }
  if (!node.scale.empty()) result = glm::scale(result, glm::make_vec3(node.scale.data()));
  return result;
}

std::vector<PlacedNode> placed_nodes(const Document& document) {
  const tinygltf::Model& model = document.model;
  const bool has_scene = model.defaultScene >= 0 || !model.scenes.empty();
  std::vector<PlacedNode> placed;
  place(model.nodes,
        has_scene ? model.scenes[static_cast<size_t>(std::max(model.defaultScene, 0))].nodes : without_parent(model),
        placed);
  return placed;
}

void add_other_nodes(const Document& document, std::vector<PlacedNode>& placed) {
  place(document.model.nodes, without_parent(document.model), placed);
}

void add_placed(std::vector<float>& all, const glm::dmat4& transform, const float* position, size_t i,
                const std::string& where) {
  const glm::dvec4 placed = transform * glm::dvec4(glm::make_vec3(position), 1.0);
  for (int k = 0; k < 3; ++k) {
    const auto rounded = static_cast<float>(placed[k]);
    if (!std::isfinite(rounded)) {
      fail(where, ".attributes.POSITION: element ", i, " leaves the range of a float when placed");
    }
    all.push_back(rounded);
  }
}

glm::dvec3 transformed_normal(const glm::dmat4& transform, const glm::dvec3& normal) {
  const glm::dvec3 x(transform[0]);
  const glm::dvec3 y(transform[1]);
  const glm::dvec3 z(transform[2]);
  const glm::dvec3 turned = glm::dmat3(glm::cross(y, z), glm::cross(z, x), glm::cross(x, y)) * normal;
  return glm::determinant(glm::dmat3(transform)) < 0 ? -turned : turned;
}

}  // namespace dr::io::gltf
