// SPDX-License-Identifier: Apache-2.0
// Names of element types, and back.
#include "compiler/ir/type.h"

#include <array>

namespace dr::ir {
namespace {

constexpr std::array<std::string_view, 4> kScalarNames = {"bool", "int", "uint", "float"};
constexpr std::array<std::string_view, 4> kVectorNames = {"bvec", "ivec", "uvec", "vec"};

std::optional<uint8_t> size_digit(char c) {
  if (c < '2' || c > '4') return std::nullopt;
  return static_cast<uint8_t>(c - '0');
}

}  // namespace

std::string Type::str() const {
  const auto kind = static_cast<size_t>(scalar);
  if (is_scalar()) return std::string(kScalarNames[kind]);
  if (is_vector()) return std::string(kVectorNames[kind]) + std::to_string(rows);
  const std::string columns = "mat" + std::to_string(cols);
  return rows == cols ? columns : columns + "x" + std::to_string(rows);
}

std::optional<Type> Type::parse(std::string_view name) {
  for (size_t kind = 0; kind < kScalarNames.size(); ++kind) {
    const auto scalar = static_cast<Scalar>(kind);
    if (name == kScalarNames[kind]) return Type{scalar, 1, 1};
    const std::string_view vector = kVectorNames[kind];
    if (name.size() == vector.size() + 1 && name.starts_with(vector)) {
      if (auto rows = size_digit(name.back())) return Type{scalar, *rows, 1};
      return std::nullopt;
    }
  }
  if (!name.starts_with("mat")) return std::nullopt;
  const bool square = name.size() == 4;
  if (!square && !(name.size() == 6 && name[4] == 'x')) return std::nullopt;
  const auto cols = size_digit(name[3]);
  const auto rows = square ? cols : size_digit(name[5]);
  if (!cols || !rows) return std::nullopt;
  return Type{Scalar::Float, *rows, *cols};
}

}  // namespace dr::ir
