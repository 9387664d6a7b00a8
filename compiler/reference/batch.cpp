// SPDX-License-Identifier: Apache-2.0
// Batches: cutting them out of images, and the arithmetic that several kinds of ops share.
#include "compiler/reference/batch.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "compiler/ops/op.h"

namespace dr::reference {

Image zeros(ir::Type type, int64_t width, int64_t height, int64_t layers) {
  Image image{type, width, height, layers, {}};
  image.data.assign(components(type) * size_of(image).count(), 0.0);
  return image;
}

Places places_of_range(Size domain, size_t begin, size_t n) {
  Places places;
  places.x.resize(n);
  places.y.resize(n);
  places.l.resize(n);
  const auto w = static_cast<size_t>(domain.w), h = static_cast<size_t>(domain.h);
  size_t x = begin % w, y = begin / w % h, l = begin / (w * h);
  for (size_t i = 0; i < n; ++i) {
    places.x[i] = static_cast<int32_t>(x);
    places.y[i] = static_cast<int32_t>(y);
    places.l[i] = static_cast<int32_t>(l);
    if (++x < w) continue;
    x = 0;
    if (++y < h) continue;
    y = 0;
    ++l;
  }
  return places;
}

const double* fetch_range(const Image& image, Size size, size_t begin, size_t n, double* scratch) {
  const size_t count = size_of(image).count();
  const size_t planes = components(image.type);
  if (size_of(image) == size) {
    if (planes == 1) return image.data.data() + begin;
    if (n == count) return image.data.data();
    for (size_t c = 0; c < planes; ++c) std::copy_n(image.data.data() + c * count + begin, n, scratch + c * n);
    return scratch;
  }
  if (count == 1) {
    for (size_t c = 0; c < planes; ++c) std::fill_n(scratch + c * n, n, image.data[c]);
    return scratch;
  }
  const Strides strides(image);
  const auto w = static_cast<size_t>(size.w), h = static_cast<size_t>(size.h);
  size_t x = begin % w, y = begin / w % h, l = begin / (w * h);
  for (size_t i = 0; i < n;) {
    const size_t run = std::min(n - i, w - x);
    const double* row = image.data.data() + l * strides.l + y * strides.y;
    for (size_t c = 0; c < planes; ++c, row += count) {
      if (strides.x != 0) {
        std::copy_n(row + x, run, scratch + c * n + i);
      } else {
        std::fill_n(scratch + c * n + i, run, *row);
      }
    }
    i += run;
    x = 0;
    if (++y == h) {
      y = 0;
      ++l;
    }
  }
  return scratch;
}

size_t first_not_finite(const double* data, size_t components, size_t n) {
  size_t first = n;
  for (size_t c = 0; c < components; ++c) {
    for (size_t i = 0; i < first; ++i) {
      if (!std::isfinite(data[c * n + i])) first = i;
    }
  }
  return first;
}

double wrap(double value, ir::Scalar scalar) {
  switch (scalar) {
    case ir::Scalar::Int: return static_cast<double>(static_cast<int32_t>(static_cast<int64_t>(value)));
    case ir::Scalar::Uint: return static_cast<double>(static_cast<uint32_t>(static_cast<int64_t>(value)));
    case ir::Scalar::Bool:
    case ir::Scalar::Float: return value;
  }
  DR_ICE("unknown scalar");
}

double fold_start(ir::Yield how, ir::Scalar scalar) {
  const bool min = how == ir::Yield::Min;
  switch (scalar) {
    case ir::Scalar::Int: return min ? std::numeric_limits<int32_t>::max() : std::numeric_limits<int32_t>::min();
    case ir::Scalar::Uint: return min ? std::numeric_limits<uint32_t>::max() : 0;
    case ir::Scalar::Bool: return min ? 1 : 0;
    case ir::Scalar::Float: break;
  }
  const double infinity = std::numeric_limits<double>::infinity();
  return min ? infinity : -infinity;
}

void evaluate_batch(const ir::Graph& graph, const ir::Op& op, size_t n, std::span<const double* const> operands,
                    double* result, bool float32) {
  ir::Type types[kMaxOperands];
  for (size_t k = 0; k < operands.size(); ++k) types[k] = graph.value(op.operands[k]).type;
  const auto eval = ops::info(op.kind).eval;
  DR_ASSERT(eval != nullptr);
  const ir::Type type = graph.value(op.results[0]).type;
  eval({.n = n,
        .operands = operands,
        .operand_types = std::span(types, operands.size()),
        .attrs = op.attrs,
        .result_type = type,
        .result = result});
  if (float32 && type.is_float()) round_to_float(result, n * components(type));
}

}  // namespace dr::reference
