// SPDX-License-Identifier: Apache-2.0
// Where the nodes of a glTF file stand, in float64. Private to compiler/io; every function throws Failure.
#pragma once

#include <glm/mat4x4.hpp>
#include <glm/vec3.hpp>
#include <string>
#include <vector>

#include "compiler/io/mesh/gltf/document.h"

namespace dr::io::gltf {

// Translation, rotation and scale, in that order from left to right, or the matrix that the file gives.
glm::dmat4 local_transform(const tinygltf::Node& node);

// One node of the scene.
struct PlacedNode {
  int node;
  int parent;  // -1: none
  glm::dmat4 world;
};

// Every node of the default scene (else the first one, else all nodes without a parent), from parents to children and
// in the order of the file.
std::vector<PlacedNode> placed_nodes(const Document& document);

// Adds the nodes of other scenes, and of none, to these.
void add_other_nodes(const Document& document, std::vector<PlacedNode>& placed);

// Adds the place of vertex `i`, as floats. `where` names the primitive.
void add_placed(std::vector<float>& all, const glm::dmat4& transform, const float* position, size_t i,
                const std::string& where);

// The direction of a normal: the inverse transpose up to a factor, defined for flat scales, too. A mirror keeps it on
// the side where it was.
glm::dvec3 transformed_normal(const glm::dmat4& transform, const glm::dvec3& normal);

}  // namespace dr::io::gltf
