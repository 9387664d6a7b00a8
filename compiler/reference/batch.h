// SPDX-License-Identifier: Apache-2.0
// What all op evaluations share: work goes in batches of elements, whose values are component-major planes
// (component c of element i at [c * n + i]), small enough to stay in a processor's cache.
#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "compiler/ir/graph.h"
#include "compiler/reference/evaluate.h"

namespace dr::reference {

// Elements of a batch. Also the size of the pieces into which domains are cut, on which the order of sums depends.
inline constexpr size_t kBatch = 1024;

// The most that an element-wise op has: the columns of a mat4 from its components.
inline constexpr size_t kMaxOperands = 16;

struct Size {
  int64_t w = 1, h = 1, l = 1;
  size_t count() const { return static_cast<size_t>(w * h * l); }
  friend bool operator==(const Size&, const Size&) = default;
};
inline Size size_of(const Image& image) { return {image.width, image.height, image.layers}; }
inline size_t components(ir::Type type) { return static_cast<size_t>(type.components()); }

// Where in an image an element of a larger extent reads: an axis of one element stretches.
struct Strides {
  size_t x, y, l;
  explicit Strides(const Image& image)
      : x(image.width == 1 ? 0 : 1),
        y(image.height == 1 ? 0 : static_cast<size_t>(image.width)),
        l(image.layers == 1 ? 0 : static_cast<size_t>(image.width * image.height)) {}
};

// The op that made the first NaN or Inf of a value out of finite operands, the element where, and what it was made of.
struct Origin {
  ir::OpId op;
  int64_t x = 0, y = 0, l = 0;
  std::shared_ptr<const std::vector<std::vector<double>>> operands = {};  // components there; none if not one element's
  bool valid() const { return op.valid(); }
};

// Memory that is not initialized.
class Buffer {
 public:
  Buffer() = default;
  explicit Buffer(size_t capacity) : data_(new double[capacity]), capacity_(capacity) {}
  double* data() const { return data_.get(); }
  size_t capacity() const { return capacity_; }

 private:
  std::unique_ptr<double[]> data_;
  size_t capacity_ = 0;
};

// Hands buffers out again, the one returned last first: its memory is still in the cache. One a worker.
class Pool {
 public:
  Buffer take(size_t n) {
    const size_t k = bucket(n);
    if (free_[k].empty()) return Buffer(size_t{1} << k);
    Buffer buffer = std::move(free_[k].back());
    free_[k].pop_back();
    return buffer;
  }
  void give(Buffer&& buffer) {
    if (buffer.data() != nullptr) free_[bucket(buffer.capacity())].push_back(std::move(buffer));
  }

 private:
  static size_t bucket(size_t n) { return static_cast<size_t>(std::bit_width(n <= 1 ? size_t{0} : n - 1)); }
  std::vector<Buffer> free_[64];
};

// The values of one batch, or one for all its elements.
struct Lanes {
  const double* data = nullptr;  // as planes of n
  size_t n = 0;                  // the list's length, or 1: the same for all elements, or 0: not computed
  Buffer own;                    // empty when the data is another's
  Origin origin;                 // when check_finite: of the first element that is not finite

  double at(size_t component, size_t i) const { return data[component * n + (n == 1 ? 0 : i)]; }
};

// Positions of the elements of a work list.
struct Places {
  std::vector<int32_t> x, y, l;
  size_t size() const { return x.size(); }
};
// The elements [begin, begin + n) of a domain in memory order.
Places places_of_range(Size domain, size_t begin, size_t n);

// Elements [begin, begin + n) of `image` stretched to `size`. The answer is `scratch`, which has room for n elements,
// or points into the image where that has the same form.
const double* fetch_range(const Image& image, Size size, size_t begin, size_t n, double* scratch);

// Rounds numbers to the nearest float32.
inline void round_to_float(double* data, size_t n) {
  for (size_t i = 0; i < n; ++i) data[i] = static_cast<double>(static_cast<float>(data[i]));
}

// An integer result wrapped to its 32 bits.
double wrap(double value, ir::Scalar scalar);

// How an index names an element: 1 component: x; 2: x and y; both in the layer `own_layer` or the only one; 3: x, y,
// layer. Returns the place in the image's planes, or -1 outside.
inline int64_t place_of_index(Size image, size_t index_components, const double* index, size_t stride,
                              int32_t own_layer) {
  const double x = index[0];
  const double y = index_components > 1 ? index[stride] : 0;
  const double l = index_components > 2 ? index[2 * stride] : image.l == 1 ? 0 : own_layer;
  const bool inside = x >= 0 && x < static_cast<double>(image.w) && y >= 0 && y < static_cast<double>(image.h) &&
                      l >= 0 && l < static_cast<double>(image.l);
  if (!inside) return -1;
  return (static_cast<int64_t>(l) * image.h + static_cast<int64_t>(y)) * image.w + static_cast<int64_t>(x);
}

// Index of the first element with a component that is not finite, or n.
size_t first_not_finite(const double* data, size_t components, size_t n);

// Combining two numbers of a minimum or maximum over many: a NaN loses against anything.
inline double fold_min(double best, double x) { return x < best ? x : best; }
inline double fold_max(double best, double x) { return x > best ? x : best; }
// What a minimum (maximum) over no numbers is.
double fold_start(ir::Yield how, ir::Scalar scalar);

// Runs the table's evaluation of an element-wise op; `float32` rounds what it gives.
void evaluate_batch(const ir::Graph& graph, const ir::Op& op, size_t n, std::span<const double* const> operands,
                    double* result, bool float32);

}  // namespace dr::reference
