// SPDX-License-Identifier: Apache-2.0
// Between GLM's matrices and the plain ones of compiler/io/mesh/scene.h. Private to compiler/io.
#pragma once

#include <algorithm>
#include <glm/gtc/type_ptr.hpp>
#include <glm/mat4x4.hpp>

#include "compiler/io/mesh/scene.h"

namespace dr::io::gltf {

inline Matrix to_matrix(const glm::dmat4& m) {
  Matrix result;
  std::copy_n(glm::value_ptr(m), 16, result.begin());
  return result;
}

inline glm::dmat4 from_matrix(const Matrix& m) { return glm::make_mat4(m.data()); }

}  // namespace dr::io::gltf
