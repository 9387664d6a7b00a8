// SPDX-License-Identifier: Apache-2.0
// Dense host arrays: what is bound to a leaf of a program and what is read back from it. Loading (`load_binding`) and
// saving (`save_array`) by file name live here too; meshes as a whole are in compiler/io/mesh/mesh.h.
#pragma once

#include <cassert>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "compiler/io/file/result.h"

namespace dr::io {

// The kind of one scalar. A Bool takes one byte, 0 or 1.
enum class ElementKind : uint8_t { Float32, Float64, Int32, UInt32, Bool };

size_t scalar_size(ElementKind kind);          // in bytes
std::string_view kind_name(ElementKind kind);  // "float32"

// The kind that `T` is stored as; only these types are array scalars.
template <class T>
struct KindOf;
template <>
struct KindOf<float> {
  static constexpr ElementKind value = ElementKind::Float32;
};
template <>
struct KindOf<double> {
  static constexpr ElementKind value = ElementKind::Float64;
};
template <>
struct KindOf<int32_t> {
  static constexpr ElementKind value = ElementKind::Int32;
};
template <>
struct KindOf<uint32_t> {
  static constexpr ElementKind value = ElementKind::UInt32;
};
template <>
struct KindOf<bool> {
  static constexpr ElementKind value = ElementKind::Bool;
};
static_assert(sizeof(bool) == 1);

// A dense host array: `components` scalars per element, elements in x-fastest order (x, then y, then layer). Row y = 0
// is the top of a picture. A matrix is stored column after column. A default-made array is empty.
struct Array {
  ElementKind kind = ElementKind::Float32;
  int components = 1;
  int64_t width = 0;
  int64_t height = 1;
  int64_t layers = 1;
  std::vector<std::byte> bytes;

  int64_t size() const { return width * height * layers; }  // elements
  int64_t scalar_count() const { return size() * components; }
  bool empty() const { return bytes.empty(); }
  // Whether the extent is positive and `bytes` holds exactly what the extent says. Loaders and factories only make
  // such.
  bool consistent() const;

  // All zeros. Precondition: positive components and extent, and a byte count that fits kMaxArrayBytes.
  static Array zeros(ElementKind kind, int components, int64_t width, int64_t height = 1, int64_t layers = 1);

  // Copies of `values`. A `width` of 0 means: as many elements as there are. Precondition: the counts agree.
  template <class T>
  static Array from(std::span<const T> values, int components, int64_t width, int64_t height, int64_t layers);
  static Array from_floats(std::span<const float> values, int components = 1, int64_t width = 0, int64_t height = 1,
                           int64_t layers = 1);
  static Array from_doubles(std::span<const double> values, int components = 1, int64_t width = 0, int64_t height = 1,
                            int64_t layers = 1);
  static Array from_ints(std::span<const int32_t> values, int components = 1, int64_t width = 0, int64_t height = 1,
                         int64_t layers = 1);

  // The scalars in place. Precondition: `kind` is the kind of T.
  template <class T>
  std::span<const T> as() const {
    assert(kind == KindOf<T>::value);
    return {reinterpret_cast<const T*>(bytes.data()), bytes.size() / sizeof(T)};
  }
  template <class T>
  std::span<T> as() {
    assert(kind == KindOf<T>::value);
    return {reinterpret_cast<T*>(bytes.data()), bytes.size() / sizeof(T)};
  }

  // Every scalar, whatever the kind; false is 0, true is 1.
  std::vector<double> to_doubles() const;
  std::vector<float> to_floats() const;
  // One of them. Precondition: 0 <= index < scalar_count().
  double scalar(int64_t index) const;

  // The same array with scalars of another kind. Floats are rounded to the nearest float32 (too large is an error); a
  // number becomes an integer or a bool only when nothing is lost, so that 0.5 is never an index.
  Result<Array> converted(ElementKind to) const;
};

// Where an element stands that is not what it should be, and the number found there.
struct Place {
  int64_t x = 0, y = 0, layer = 0;
  double value = 0;
};
// The scalars of an array in memory that may be somebody else's, elements in the order of Array.
struct Scalars {
  ElementKind kind = ElementKind::Float32;
  int components = 1;
  int64_t width = 0, height = 1, layers = 1;
  const std::byte* data = nullptr;
};
Scalars scalars_of(const Array& array);
// The first element with a component that is NaN or Inf, if there is one.
std::optional<Place> first_not_finite(const Scalars& scalars);
std::optional<Place> first_not_finite(const Array& array);
// "NaN at element (3, 1, 0)", or Inf or -Inf.
std::string describe(const Place& not_finite);

// The most that one array, whatever it is loaded from, may take.
inline constexpr int64_t kMaxArrayBytes = int64_t{1} << 34;

// Loads what a user writes after `--bind name=`. `expected_components` is the number of scalars in one element of the
// leaf (3 for vec3, 16 for mat4); 0 means unknown. When it is known, the result has exactly that many or it is an
// error.
//
//   mesh.obj:position  :indices :uv :uv_indices :normal :color   also .gltf and .glb; see compiler/io/mesh/mesh.h
//   scene.glb:camera:view  :light:Sun:color ...   cameras, lamps, materials, skins: docs/reference/files.md
//   picture.png        .jpg .jpeg .hdr; `:raw` (value / 255, no sRGB curve), `:r` `:rgb` `:rgba` `:a` pick channels
//   views/*.png        pictures of one size, as layers, in the order of the names' bytes
//   values.npy         C order
//   values.csv         a table, a line a row; a first line of words is left out
//   values.json        nested lists of numbers, as after `=`
//   =3.5  =[1, 2, 3]   JSON; the `=` may be left out before a number or a list
//
// Pictures give float32. The colour of an 8 or 16-bit picture is sRGB and is made linear, alpha is linear already. A
// picture that stores grey is data (a mask, a height) and is linear, unless `:rgb` or `:rgba` asks for a colour. A
// missing alpha is 1 for `:rgba`. Orientation tags, gamma and colour profiles are not applied.
//
// .npy, .csv and JSON fill the extent from its last dimension on: shape (layers, height, width, c) or any tail of it
// when the last dimension is the expected c > 1, else (layers, height, width) or a tail. With an unknown c, a fourth
// dimension is the components. So `=[[1, 2], [3, 4]]` is two vec2 in a row, or a float image of 2x2.
Result<Array> load_binding(std::string_view source, int expected_components = 0);
// Whether a file's name is one of those that load_binding() reads.
bool is_bindable(std::string_view path);
// What is odd about data that was loaded, for a warning: a normal map that was taken for colours.
std::optional<std::string> doubt_about(std::string_view source, const Array& array);

// Writes an array, whole or not at all, by extension:
//   .csv   a list, an element a line, or a picture of one component, a row a line
//   .npy   any kind; the shape has its leading ones left out
//   .png   float or bool, 1 to 4 components, clamped to [0, 1]: 3 and 4 components are a linear colour and get the sRGB
//          curve, alpha and grey stay linear; several layers go to name_0.png, name_1.png, ... with as many digits as
//          the last one needs, so that a pattern `name_*.png` reads them back in order
Result<void> save_array(const std::string& path, const Array& array);
// The file of one layer of a .png: "name_07.png" of twelve, "name.png" of one.
std::string layer_path(const std::string& path, int64_t layer, int64_t layers);

// ---------------------------------------------------------------------------------------------------------------

// Calls `visit(value)` with every scalar of `array` as a double, which holds each kind exactly.
template <class Visit>
void for_each_scalar(const Array& array, const Visit& visit) {
  const auto walk = [&]<class T>(T) {
    const size_t count = array.bytes.size() / sizeof(T);
    for (size_t i = 0; i < count; ++i) {
      T value;
      std::memcpy(&value, array.bytes.data() + i * sizeof(T), sizeof(T));
      visit(static_cast<double>(value));
    }
  };
  switch (array.kind) {
    case ElementKind::Float32: return walk(float{});
    case ElementKind::Float64: return walk(double{});
    case ElementKind::Int32: return walk(int32_t{});
    case ElementKind::UInt32: return walk(uint32_t{});
    case ElementKind::Bool: return walk(uint8_t{});
  }
}

template <class T>
Array Array::from(std::span<const T> values, int components, int64_t width, int64_t height, int64_t layers) {
  assert(components > 0 && height > 0 && layers > 0);
  if (width == 0) width = static_cast<int64_t>(values.size()) / components / height / layers;
  Array array;
  array.kind = KindOf<T>::value;
  array.components = components;
  array.width = width;
  array.height = height;
  array.layers = layers;
  const auto raw = std::as_bytes(values);
  array.bytes.assign(raw.begin(), raw.end());
  assert(array.consistent());
  return array;
}

}  // namespace dr::io
