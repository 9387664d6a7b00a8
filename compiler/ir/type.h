// SPDX-License-Identifier: Apache-2.0
// Element types of values: GLSL's scalars, vectors and matrices.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace dr::ir {

enum class Scalar : uint8_t { Bool, Int, Uint, Float };

// rows = components of a (column) vector, cols > 1 for matrices (Float only). vec3 is {Float, 3, 1},
// mat2x3 (2 columns of 3 rows) is {Float, 3, 2}.
struct Type {
  Scalar scalar = Scalar::Float;
  uint8_t rows = 1;
  uint8_t cols = 1;

  int components() const { return rows * cols; }  // column-major order
  bool is_scalar() const { return rows == 1 && cols == 1; }
  bool is_vector() const { return rows > 1 && cols == 1; }
  bool is_matrix() const { return cols > 1; }
  bool is_float() const { return scalar == Scalar::Float; }
  bool is_integer() const { return scalar == Scalar::Int || scalar == Scalar::Uint; }
  bool is_bool() const { return scalar == Scalar::Bool; }
  Type element() const { return {scalar, 1, 1}; }    // the scalar type
  Type column() const { return {scalar, rows, 1}; }  // a matrix's column
  Type with_scalar(Scalar s) const { return {s, rows, cols}; }
  std::string str() const;  // GLSL's name: "vec3", "ivec2", "mat4"
  static std::optional<Type> parse(std::string_view name);
  friend bool operator==(const Type&, const Type&) = default;
};

inline constexpr Type kBool{Scalar::Bool, 1, 1};
inline constexpr Type kInt{Scalar::Int, 1, 1};
inline constexpr Type kUint{Scalar::Uint, 1, 1};
inline constexpr Type kFloat{Scalar::Float, 1, 1};
inline constexpr Type vec(int n, Scalar s = Scalar::Float) { return {s, static_cast<uint8_t>(n), 1}; }

}  // namespace dr::ir
