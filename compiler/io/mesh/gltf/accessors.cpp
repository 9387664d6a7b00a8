// SPDX-License-Identifier: Apache-2.0
#include "compiler/io/mesh/gltf/accessors.h"

#include <cmath>
#include <cstring>

#include "compiler/io/file/failure.h"
#include "compiler/io/mesh/gltf/container.h"
#include "compiler/io/mesh/mesh.h"

namespace dr::io::gltf {
namespace {

struct View {
  std::span<const uint8_t> bytes;
  uint64_t stride = 0;  // 0: elements follow one another
};

View view_of(const Document& document, int index) {
  const tinygltf::BufferView& view = document.model.bufferViews[static_cast<size_t>(index)];
  const std::span<const uint8_t> buffer = document.model.buffers[static_cast<size_t>(view.buffer)].data;
  return {buffer.subspan(view.byteOffset, view.byteLength), view.byteStride};
}

uint64_t scalar_size(uint64_t type) {
  switch (type) {
    case kByte:
    case kUByte: return 1;
    case kShort:
    case kUShort: return 2;
    default: return 4;
  }
}

struct Placed {
  uint64_t offset, stride, size, count;
};

// Copies elements out of a view. `where` names what lists them.
void copy_elements(const View& view, const Placed& placed, uint8_t* out, const std::string& where) {
  const auto [offset, stride, size, count] = placed;
  const uint64_t have = view.bytes.size();
  const bool fits = offset <= have && size <= have - offset && (count - 1) <= (have - offset - size) / stride;
  if (!fits) {
    fail(where, ": ", counted(static_cast<int64_t>(count), "element", "elements"), " of ", size, " bytes, ", stride,
         " apart from byte ", offset, ", do not fit the buffer view of ", have);
  }
  const uint8_t* from = view.bytes.data() + offset;
  if (stride == size) {
    std::memcpy(out, from, static_cast<size_t>(size * count));
    return;
  }
  for (uint64_t i = 0; i < count; ++i) std::memcpy(out + i * size, from + i * stride, static_cast<size_t>(size));
}

// Overwrites the elements that a sparse accessor lists.
void substitute(const Document& document, const tinygltf::Accessor& accessor, uint64_t size, Elements& target,
                const std::string& where) {
  const auto& sparse = accessor.sparse;
  const auto count = static_cast<uint64_t>(sparse.count);
  Elements indices;
  indices.component_type = static_cast<uint64_t>(sparse.indices.componentType);
  const uint64_t index_size = scalar_size(indices.component_type);
  // Both lists must fit their views before they take memory.
  const auto read = [&](int view, int offset, uint64_t element, const char* part) {
    const View from = view_of(document, view);
    std::vector<uint8_t> bytes(count <= from.bytes.size() ? static_cast<size_t>(element * count) : 0);
    copy_elements(from, {static_cast<uint64_t>(offset), element, element, count}, bytes.data(), where + part);
    return bytes;
  };
  indices.bytes = read(sparse.indices.bufferView, sparse.indices.byteOffset, index_size, ".indices");
  const std::vector<uint8_t> values = read(sparse.values.bufferView, sparse.values.byteOffset, size, ".values");
  uint64_t previous = 0;
  for (uint64_t i = 0; i < count; ++i) {
    const uint64_t index = unsigned_at(indices, i);
    if (index >= target.count) {
      fail(where, ".indices: index ", i, " is ", index, ", the accessor has ", target.count, " elements");
    }
    if (i > 0 && index <= previous) {
      fail(where, ".indices: index ", i, " is ", index, " after ", previous, ", they must increase");
    }
    previous = index;
    std::memcpy(target.bytes.data() + index * size, values.data() + i * size, static_cast<size_t>(size));
  }
}

float scalar_at(const Elements& elements, size_t i) {
  const uint8_t* p = elements.bytes.data();
  switch (elements.component_type) {
    case kFloat: {
      const uint32_t bits = read_u32(elements.bytes, i * 4);
      float value = 0;
      std::memcpy(&value, &bits, 4);
      return value;
    }
    case kUByte: return static_cast<float>(p[i]) / 255.0f;
    case kUShort: return static_cast<float>(unsigned_at(elements, i)) / 65535.0f;
    case kByte: return std::max(static_cast<float>(static_cast<int8_t>(p[i])) / 127.0f, -1.0f);
    default: return std::max(static_cast<float>(static_cast<int16_t>(p[i * 2] | p[i * 2 + 1] << 8)) / 32767.0f, -1.0f);
  }
}

}  // namespace

uint64_t unsigned_at(const Elements& elements, uint64_t i) {
  const uint8_t* p = elements.bytes.data();
  switch (elements.component_type) {
    case kUByte: return p[i];
    case kUShort: return static_cast<uint64_t>(p[i * 2]) | static_cast<uint64_t>(p[i * 2 + 1]) << 8;
    default: return read_u32(elements.bytes, static_cast<size_t>(i * 4));
  }
}

Elements read_elements(const Document& document, uint64_t index, uint64_t limit) {
  const tinygltf::Accessor& accessor = document.model.accessors[static_cast<size_t>(index)];
  const auto where = [&] { return cat("accessors[", index, "]"); };
  Elements result;
  result.component_type = static_cast<uint64_t>(accessor.componentType);
  result.components = static_cast<uint64_t>(tinygltf::GetNumComponentsInType(static_cast<uint32_t>(accessor.type)));
  result.count = accessor.count;
  result.normalized = accessor.normalized;
  const uint64_t size = scalar_size(result.component_type) * result.components;
  if (result.count > limit) fail(where(), ".count: ", result.count, " is over the limit of ", limit);
  if (accessor.bufferView >= 0) {
    const View view = view_of(document, accessor.bufferView);
    const uint64_t stride = view.stride != 0 ? view.stride : size;
    if (stride < size)
      fail("bufferViews[", accessor.bufferView, "].byteStride: ", stride, " is not in ", size, " to 252");
    // A count that the view cannot hold must not cost memory.
    const bool possible = result.count - 1 <= view.bytes.size() / stride;
    result.bytes.resize(possible ? static_cast<size_t>(size * result.count) : 0);
    copy_elements(view, {accessor.byteOffset, stride, size, result.count}, result.bytes.data(), where());
  } else {
    // Elements that only a number stands for. A mesh has some of its bytes in a buffer, so no honest file asks for more
    // of them than that.
    if (result.count > document.buffer_bytes) {
      fail(where(), ".count: ", result.count, " elements without a buffer view, more than the ", document.buffer_bytes,
           " bytes of all buffers");
    }
    result.bytes.resize(static_cast<size_t>(size * result.count));
  }
  if (accessor.sparse.isSparse) substitute(document, accessor, size, result, where() + ".sparse");
  return result;
}

std::vector<uint32_t> read_order(const Document& document, const tinygltf::Primitive& primitive, uint64_t vertex_count,
                                 const std::string& where) {
  std::vector<uint32_t> order;
  if (primitive.indices < 0) {
    order.resize(static_cast<size_t>(vertex_count));
    for (size_t i = 0; i < order.size(); ++i) order[i] = static_cast<uint32_t>(i);
    return order;
  }
  const auto named = [&] { return cat(where, ".indices"); };
  const Elements raw =
      read_elements(document, static_cast<uint64_t>(primitive.indices), static_cast<uint64_t>(kMaxTriangles) * 3);
  const uint64_t type = raw.component_type;
  if (raw.components != 1 || (type != kUByte && type != kUShort && type != kUInt)) {
    fail(named(), ": expected unsigned scalars, found ", raw.components, " x component type ", type);
  }
  order.resize(static_cast<size_t>(raw.count));
  for (size_t i = 0; i < order.size(); ++i) {
    const uint64_t index = unsigned_at(raw, i);
    if (index >= vertex_count) {
      fail(named(), ": index ", i, " is ", index, ", the primitive has ", vertex_count, " vertices");
    }
    order[i] = static_cast<uint32_t>(index);
  }
  return order;
}

Floats read_floats(const Document& document, uint64_t index, const Expected& expected, uint64_t limit,
                   const std::string& where) {
  const Elements elements = read_elements(document, index, limit);
  const uint64_t type = elements.component_type;
  const bool is_unsigned = type == kUByte || type == kUShort;
  const bool is_signed = type == kByte || type == kShort;
  const bool integer = elements.normalized && ((expected.integers != Integers::None && is_unsigned) ||
                                               (expected.integers == Integers::Normalized && is_signed));
  if (type != kFloat && !integer) {
    constexpr std::string_view kAllowed[] = {"floats", "floats or normalized unsigned integers",
                                             "floats or normalized integers"};
    fail(where, ": component type ", type, elements.normalized ? " (normalized)" : "", ", expected ",
         kAllowed[static_cast<size_t>(expected.integers)]);
  }
  const uint64_t components = elements.components;
  if (components < expected.least_components || components > expected.most_components) {
    fail(where, ": ", components, " components, expected ",
         expected.least_components == expected.most_components
             ? cat(expected.least_components)
             : cat(expected.least_components, " or ", expected.most_components));
  }
  if (expected.count != 0 && elements.count != expected.count) {
    fail(where, ": ", elements.count, " elements, but POSITION has ", expected.count);
  }
  Floats result;
  result.components = components;
  result.values.resize(static_cast<size_t>(elements.count * components));
  for (size_t i = 0; i < result.values.size(); ++i) {
    const float value = scalar_at(elements, i);
    if (!std::isfinite(value)) {
      fail(where, ": element ", i / components, " holds ", std::isnan(value) ? "NaN" : "an infinite value");
    }
    result.values[i] = value;
  }
  return result;
}

}  // namespace dr::io::gltf
