// SPDX-License-Identifier: Apache-2.0
// Scalar kinds and conversions of host arrays.

#include "compiler/io/array/array.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "compiler/io/file/failure.h"

namespace dr::io {
namespace {

// The value as a scalar of type T, or nothing when T cannot hold it.
template <class T>
bool fits(double value) {
  return value >= static_cast<double>(std::numeric_limits<T>::lowest()) &&
         value <= static_cast<double>(std::numeric_limits<T>::max()) && value == std::floor(value);
}

}  // namespace

size_t scalar_size(ElementKind kind) {
  switch (kind) {
    case ElementKind::Float32:
    case ElementKind::Int32:
    case ElementKind::UInt32: return 4;
    case ElementKind::Float64: return 8;
    case ElementKind::Bool: return 1;
  }
  assert(false);
  return 1;
}

std::string_view kind_name(ElementKind kind) {
  switch (kind) {
    case ElementKind::Float32: return "float32";
    case ElementKind::Float64: return "float64";
    case ElementKind::Int32: return "int32";
    case ElementKind::UInt32: return "uint32";
    case ElementKind::Bool: return "bool";
  }
  assert(false);
  return "";
}

bool Array::consistent() const {
  if (components <= 0 || width <= 0 || height <= 0 || layers <= 0) return false;
  // Divide instead of multiplying: the product of hostile extents must not wrap around to the right byte count.
  uint64_t left = bytes.size();
  for (const uint64_t factor : {static_cast<uint64_t>(scalar_size(kind)), static_cast<uint64_t>(components),
                                static_cast<uint64_t>(width), static_cast<uint64_t>(height)}) {
    if (left % factor != 0) return false;
    left /= factor;
  }
  return left == static_cast<uint64_t>(layers);
}

Array Array::zeros(ElementKind kind, int components, int64_t width, int64_t height, int64_t layers) {
  Array array;
  array.kind = kind;
  array.components = components;
  array.width = width;
  array.height = height;
  array.layers = layers;
  array.bytes.resize(static_cast<size_t>(array.scalar_count()) * scalar_size(kind));
  assert(array.consistent());
  return array;
}

Array Array::from_floats(std::span<const float> values, int components, int64_t width, int64_t height, int64_t layers) {
  return from<float>(values, components, width, height, layers);
}

Array Array::from_doubles(std::span<const double> values, int components, int64_t width, int64_t height,
                          int64_t layers) {
  return from<double>(values, components, width, height, layers);
}

Array Array::from_ints(std::span<const int32_t> values, int components, int64_t width, int64_t height, int64_t layers) {
  return from<int32_t>(values, components, width, height, layers);
}

std::vector<double> Array::to_doubles() const {
  std::vector<double> values;
  values.reserve(bytes.size() / scalar_size(kind));
  for_each_scalar(*this, [&](double value) { values.push_back(value); });
  return values;
}

std::vector<float> Array::to_floats() const {
  std::vector<float> values;
  values.reserve(bytes.size() / scalar_size(kind));
  for_each_scalar(*this, [&](double value) { values.push_back(static_cast<float>(value)); });
  return values;
}

double Array::scalar(int64_t index) const {
  const auto read = [&]<class T>(T value) {
    std::memcpy(&value, bytes.data() + static_cast<size_t>(index) * sizeof(T), sizeof(T));
    return static_cast<double>(value);
  };
  switch (kind) {
    case ElementKind::Float32: return read(float{});
    case ElementKind::Float64: return read(double{});
    case ElementKind::Int32: return read(int32_t{});
    case ElementKind::UInt32: return read(uint32_t{});
    case ElementKind::Bool: return read(uint8_t{});
  }
  assert(false);
  return 0;
}

Scalars scalars_of(const Array& array) {
  return {array.kind, array.components, array.width, array.height, array.layers, array.bytes.data()};
}

std::optional<Place> first_not_finite(const Scalars& s) {
  const int64_t count = s.components * s.width * s.height * s.layers;
  const auto first = [&]<class T>(T value) -> std::optional<Place> {
    // Whole blocks first, without a branch a scalar: nearly always all are finite.
    constexpr int64_t kBlock = 1024;
    for (int64_t begin = 0; begin < count; begin += kBlock) {
      const int64_t end = std::min(count, begin + kBlock);
      bool finite = true;
      for (int64_t i = begin; i < end; ++i) {
        std::memcpy(&value, s.data + static_cast<size_t>(i) * sizeof(T), sizeof(T));
        finite &= std::abs(value) <= std::numeric_limits<T>::max();
      }
      for (int64_t i = begin; !finite && i < end; ++i) {
        std::memcpy(&value, s.data + static_cast<size_t>(i) * sizeof(T), sizeof(T));
        if (std::isfinite(value)) continue;
        const int64_t element = i / s.components, row = element / s.width;
        return Place{element % s.width, row % s.height, row / s.height, static_cast<double>(value)};
      }
    }
    return std::nullopt;
  };
  if (s.kind == ElementKind::Float32) return first(float{});
  if (s.kind == ElementKind::Float64) return first(double{});
  return std::nullopt;
}

std::optional<Place> first_not_finite(const Array& array) { return first_not_finite(scalars_of(array)); }

std::string describe(const Place& p) {
  return cat(std::isnan(p.value) ? "NaN"
             : p.value > 0       ? "Inf"
                                 : "-Inf",
             " at element (", p.x, ", ", p.y, ", ", p.layer, ")");
}

Result<Array> Array::converted(ElementKind to) const {
  if (to == kind) return *this;
  return guarded(cat("cannot turn ", kind_name(kind), " into ", kind_name(to), ": "), [&] {
    Array result = *this;
    result.kind = to;
    result.bytes.resize(bytes.size() / scalar_size(kind) * scalar_size(to));
    size_t next = 0;
    const auto put = [&]<class T>(T value) {
      std::memcpy(result.bytes.data() + next * sizeof(T), &value, sizeof(T));
      ++next;
    };
    const auto refuse = [&](double value) { fail("scalar ", next, " is ", value); };
    for_each_scalar(*this, [&](double value) {
      switch (to) {
        case ElementKind::Float32:
          if (std::isfinite(value) && !std::isfinite(static_cast<float>(value))) refuse(value);
          return put(static_cast<float>(value));
        case ElementKind::Float64: return put(value);
        case ElementKind::Int32:
          if (!fits<int32_t>(value)) refuse(value);
          return put(static_cast<int32_t>(value));
        case ElementKind::UInt32:
          if (!fits<uint32_t>(value)) refuse(value);
          return put(static_cast<uint32_t>(value));
        case ElementKind::Bool:
          if (value != 0 && value != 1) refuse(value);
          return put(static_cast<uint8_t>(value));
      }
    });
    return result;
  });
}

}  // namespace dr::io
