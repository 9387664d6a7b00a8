// SPDX-License-Identifier: Apache-2.0
#include "compiler/reference/arrays.h"

#include <cmath>

namespace dr::reference {

io::ElementKind kind_of(ir::Scalar scalar) {
  switch (scalar) {
    case ir::Scalar::Bool: return io::ElementKind::Bool;
    case ir::Scalar::Int: return io::ElementKind::Int32;
    case ir::Scalar::Uint: return io::ElementKind::UInt32;
    case ir::Scalar::Float: return io::ElementKind::Float64;
  }
  DR_ICE("a scalar of no kind");
}

Image to_image(const io::Array& array, const ir::Type& type) {
  Image image = zeros(type, array.width, array.height, array.layers);
  const auto n = static_cast<size_t>(array.components), count = static_cast<size_t>(array.size());
  size_t element = 0, component = 0;
  io::for_each_scalar(array, [&](double value) {
    image.data[component * count + element] = value;
    if (++component == n) component = 0, ++element;
  });
  return image;
}

io::Result<io::Array> to_array(const Image& image) {
  const auto n = static_cast<size_t>(image.type.components()), count = static_cast<size_t>(image.count());
  std::vector<double> values(n * count);
  for (size_t e = 0; e < count; ++e)
    for (size_t c = 0; c < n; ++c) values[e * n + c] = image.data[c * count + e];
  auto array = io::Array::from_doubles(values, image.type.components(), image.width, image.height, image.layers);
  const io::ElementKind kind = kind_of(image.type.scalar);
  return kind == io::ElementKind::Float64 ? io::Result<io::Array>(std::move(array)) : array.converted(kind);
}

std::optional<io::Place> first_not_finite(const Image& image) {
  const auto count = static_cast<size_t>(image.count());
  std::optional<size_t> first;
  for (size_t i = 0; i < image.data.size(); ++i)
    if (!std::isfinite(image.data[i]) && (!first || i % count < *first % count)) first = i;
  if (!first) return std::nullopt;
  const auto element = static_cast<int64_t>(*first % count), row = element / image.width;
  return io::Place{element % image.width, row % image.height, row / image.height, image.data[*first]};
}

}  // namespace dr::reference
