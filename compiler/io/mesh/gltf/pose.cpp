// SPDX-License-Identifier: Apache-2.0
// Where nodes, joints and cameras stand: GLM's quaternions and matrices, in float64.

#include <algorithm>
#include <cmath>
#include <glm/ext/matrix_transform.hpp>
#include <glm/gtc/quaternion.hpp>

#include "compiler/io/file/failure.h"
#include "compiler/io/mesh/gltf/matrices.h"
#include "compiler/io/mesh/scene.h"

namespace dr::io {
namespace {

using gltf::from_matrix;
using gltf::to_matrix;

glm::dquat quaternion(const std::vector<double>& q) { return {q[3], q[0], q[1], q[2]}; }

// The channel's value at `time`, as the specification interpolates it.
std::vector<double> sample(const Scene::Channel& channel, double time) {
  const bool cubic = channel.interpolation == "CUBICSPLINE";
  const size_t keys = channel.times.size();
  const size_t width = channel.values.size() / keys / (cubic ? 3 : 1);
  // Part 0 is the tangent in, 1 the value, 2 the tangent out; without tangents there is the value alone.
  const auto part = [&](size_t key, size_t which) {
    const size_t at = cubic ? (key * 3 + which) * width : key * width;
    const auto begin = channel.values.begin() + static_cast<std::ptrdiff_t>(at);
    return std::vector<double>(begin, begin + static_cast<std::ptrdiff_t>(width));
  };
  if (time <= channel.times.front()) return part(0, 1);
  if (time >= channel.times.back()) return part(keys - 1, 1);
  // In doubles: rounded to a float, a time just before the last key would be that of the key.
  const auto after = std::upper_bound(channel.times.begin(), channel.times.end(), time);
  const auto key = static_cast<size_t>(after - channel.times.begin()) - 1;
  if (channel.interpolation == "STEP") return part(key, 1);
  const double length = double{channel.times[key + 1]} - channel.times[key];
  const double t = (time - channel.times[key]) / length;
  const std::vector<double> a = part(key, 1);
  const std::vector<double> b = part(key + 1, 1);
  std::vector<double> result(width);
  if (cubic) {
    const std::vector<double> out = part(key, 2);
    const std::vector<double> in = part(key + 1, 0);
    const double t2 = t * t;
    const double t3 = t2 * t;
    for (size_t i = 0; i < width; ++i) {
      result[i] = (2 * t3 - 3 * t2 + 1) * a[i] + length * (t3 - 2 * t2 + t) * out[i] + (-2 * t3 + 3 * t2) * b[i] +
                  length * (t3 - t2) * in[i];
    }
  } else if (channel.path == "rotation") {
    const glm::dquat q = glm::slerp(glm::normalize(quaternion(a)), glm::normalize(quaternion(b)), t);
    result = {q.x, q.y, q.z, q.w};
  } else {
    for (size_t i = 0; i < width; ++i) result[i] = a[i] + (b[i] - a[i]) * t;
  }
  return result;
}

}  // namespace

std::vector<Matrix> pose_at(const Scene& scene, size_t animation, double time) {
  std::vector<Scene::Node> nodes = scene.nodes;
  for (const Scene::Channel& channel : scene.animations[animation].channels) {
    Scene::Node& node = nodes[static_cast<size_t>(channel.node)];
    if (node.translation.empty() || channel.path == "weights") continue;
    std::vector<double>& target = channel.path == "translation" ? node.translation
                                  : channel.path == "rotation"  ? node.rotation
                                                                : node.scale;
    target = sample(channel, time);
  }
  std::vector<glm::dmat4> local;
  for (const Scene::Node& node : nodes) {
    if (node.translation.empty()) {
      local.push_back(from_matrix(node.local));
      continue;
    }
    const glm::dmat4 moved = glm::translate(glm::dmat4(1.0), glm::make_vec3(node.translation.data()));
    const glm::dmat4 turned = moved * glm::mat4_cast(glm::normalize(quaternion(node.rotation)));
    local.push_back(glm::scale(turned, glm::make_vec3(node.scale.data())));
  }
  // A parent may stand anywhere in the list: each chain of parents is walked until one is known.
  std::vector<glm::dmat4> world(nodes.size());
  std::vector<bool> known(nodes.size());
  for (size_t i = 0; i < nodes.size(); ++i) {
    std::vector<size_t> chain;
    for (int at = static_cast<int>(i); at >= 0 && !known[static_cast<size_t>(at)];
         at = nodes[static_cast<size_t>(at)].parent) {
      chain.push_back(static_cast<size_t>(at));
    }
    for (auto it = chain.rbegin(); it != chain.rend(); ++it) {
      const int parent = nodes[*it].parent;
      world[*it] = parent < 0 ? local[*it] : world[static_cast<size_t>(parent)] * local[*it];
      known[*it] = true;
    }
  }
  std::vector<Matrix> result;
  for (const glm::dmat4& m : world) result.push_back(to_matrix(m));
  return result;
}

Matrix product(const Matrix& first, const Matrix& second) {
  return to_matrix(from_matrix(first) * from_matrix(second));
}

std::vector<Matrix> joint_matrices(const Scene& scene, size_t skin, const std::vector<Matrix>& world) {
  const Scene::Skin& from = scene.skins[skin];
  std::vector<Matrix> result;
  for (size_t i = 0; i < from.joints.size(); ++i) {
    result.push_back(
        to_matrix(from_matrix(world[static_cast<size_t>(from.joints[i])]) * from_matrix(from.inverse_bind[i])));
  }
  return result;
}

Matrix view_matrix(const Matrix& world) {
  // Where the camera stands and how it is turned; a scale on the way to it is not its own. Scales that differ by axis
  // skew what is turned within: it looks where it is said to look, and its upper side is as near as can be.
  const glm::dmat4 m = from_matrix(world);
  const glm::dvec3 right(m[0]), up(m[1]), back(m[2]);
  const glm::dvec3 z = glm::normalize(back), y = glm::normalize(up - glm::dot(up, z) * z), x = glm::cross(y, z);
  glm::dmat4 pose(1.0);
  pose[0] = glm::dvec4(glm::dot(right, x) < 0 ? -x : x, 0.0);
  pose[1] = glm::dvec4(y, 0.0);
  pose[2] = glm::dvec4(z, 0.0);
  pose[3] = m[3];
  if (!std::isfinite(x.x + x.y + x.z)) fail("a node on the way to it is scaled to nothing, it looks nowhere");
  return to_matrix(glm::inverse(pose));
}

Matrix projection_matrix(const Scene::Camera& camera, double aspect) {
  glm::dmat4 m(0.0);
  const double near = camera.near;
  if (camera.perspective) {
    const double f = 1 / std::tan(camera.field_of_view / 2);
    const double z = camera.far ? 1 / (near / *camera.far - 1) : -1;
    m[0][0] = f / aspect;
    m[1][1] = -f;
    m[2] = glm::dvec4(0, 0, z, -1);
    m[3][2] = near * z;
  } else {
    const double f = 1 / camera.half_height;
    m[0][0] = f / aspect;
    m[1][1] = -f;
    m[2][2] = 1 / (near - *camera.far);
    m[3] = glm::dvec4(0, 0, near / (near - *camera.far), 1);
  }
  return to_matrix(m);
}

}  // namespace dr::io
