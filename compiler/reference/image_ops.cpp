// SPDX-License-Identifier: Apache-2.0
// Whole-image ops. Each writes disjoint parts of its result from as many tasks as its size asks for; sums are pairwise
// along one axis after the other, so their order is a function of the extents.
#include "compiler/reference/image_ops.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "compiler/ops/op.h"

namespace dr::reference {
namespace {

using ir::Op;
using ir::OpKind;

// Elements that are worth a task of their own.
constexpr size_t kTask = 16 * kBatch;

// Calls body(begin, n, worker) for the batches of `count` elements.
template <class Body>
void for_batches(Workers& workers, size_t count, const Body& body) {
  workers.run((count + kTask - 1) / kTask, [&](size_t task, size_t worker) {
    const size_t end = std::min(count, (task + 1) * kTask);
    for (size_t begin = task * kTask; begin < end; begin += kBatch) body(begin, std::min(kBatch, end - begin), worker);
  });
}

void elementwise(const Context& context, const Op& op, Image& result, Workers& workers) {
  const Size size = size_of(result);
  const size_t count = size.count(), planes = components(result.type);
  std::vector<const Image*> images;
  for (ir::ValueId operand : op.operands) images.push_back(context.images[operand.index]);

  struct Scratch {
    std::vector<std::vector<double>> operands;
    std::vector<const double*> pointers;
    std::vector<double> result;
    size_t filled = 0;  // batch size for which stretched numbers stand in `operands`
  };
  std::vector<Scratch> scratch(workers.count());
  for_batches(workers, count, [&](size_t begin, size_t n, size_t worker) {
    Scratch& s = scratch[worker];
    s.operands.resize(images.size());
    s.pointers.resize(images.size());
    for (size_t k = 0; k < images.size(); ++k) {
      const Image& image = *images[k];
      if (s.operands[k].empty()) s.operands[k].resize(components(image.type) * std::min(kBatch, count));
      if (size_of(image).count() == 1 && s.filled == n && count > 1) continue;
      s.pointers[k] = fetch_range(image, size, begin, n, s.operands[k].data());
    }
    s.filled = n;
    if (planes == 1 || n == count) {
      evaluate_batch(context.graph, op, n, s.pointers, result.data.data() + begin, context.float32);
      return;
    }
    s.result.resize(planes * kBatch);
    evaluate_batch(context.graph, op, n, s.pointers, s.result.data(), context.float32);
    for (size_t c = 0; c < planes; ++c) std::copy_n(s.result.data() + c * n, n, result.data.data() + c * count + begin);
  });
}

void coord(const Op& op, Image& result, Workers& workers) {
  const Size size = size_of(result);
  for_batches(workers, size.count(), [&](size_t begin, size_t n, size_t) {
    const Places places = places_of_range(size, begin, n);
    const auto axis = op.attrs.ints[0];
    const std::vector<int32_t>& from = axis == 0 ? places.x : axis == 1 ? places.y : places.l;
    std::copy(from.begin(), from.end(), result.data.data() + begin);
  });
}

void gather(const Image& x, const Image& index, Image& result, Workers& workers) {
  const Size size = size_of(result);
  const size_t count = size.count(), from = size_of(x).count();
  const size_t planes = components(x.type), index_planes = components(index.type);
  for_batches(workers, count, [&](size_t begin, size_t n, size_t) {
    std::vector<double> scratch(index_planes * n);
    const double* indices = fetch_range(index, size, begin, n, scratch.data());
    const Places places = places_of_range(size, begin, n);
    for (size_t i = 0; i < n; ++i) {
      const int64_t at = place_of_index(size_of(x), index_planes, indices + i, n, places.l[i]);
      for (size_t c = 0; c < planes; ++c) {
        result.data[c * count + begin + i] = at < 0 ? 0.0 : x.data[c * from + static_cast<size_t>(at)];
      }
    }
  });
}

void scatter(bool maximum, const Image& index, const Image& value, Image& result, Workers& workers) {
  Size size;  // the common extent of index and value
  size.w = std::max(index.width, value.width);
  size.h = std::max(index.height, value.height);
  size.l = std::max(index.layers, value.layers);
  const size_t count = size.count(), to = size_of(result).count();
  const size_t planes = components(value.type), index_planes = components(index.type);
  const double none = std::numeric_limits<int32_t>::min();  // as on devices, the least int counts as nothing
  std::fill(result.data.begin(), result.data.end(), maximum ? none : 0.0);
  // Elements that name one place add up in their order, so only components are independent of each other.
  workers.run(planes, [&](size_t c, size_t) {
    double* out = result.data.data() + c * to;
    std::vector<double> index_scratch(index_planes * kBatch), value_scratch(planes * kBatch);
    for (size_t begin = 0; begin < count; begin += kBatch) {
      const size_t n = std::min(kBatch, count - begin);
      const double* indices = fetch_range(index, size, begin, n, index_scratch.data());
      const double* values = fetch_range(value, size, begin, n, value_scratch.data()) + c * n;
      const Places places = places_of_range(size, begin, n);
      for (size_t i = 0; i < n; ++i) {
        const int64_t at = place_of_index(size_of(result), index_planes, indices + i, n, places.l[i]);
        if (at < 0) continue;
        double& sum = out[at];
        sum = maximum ? std::max(sum, values[i]) : wrap(sum + values[i], value.type.scalar);
      }
    }
    if (maximum) std::replace(out, out + to, none, 0.0);
  });
}

void shift(const Op& op, const Image& x, Image& result, Workers& workers) {
  const int64_t dx = op.attrs.ints[0], dy = op.attrs.ints[1];
  const int64_t w = x.width, h = x.height;
  const size_t rows = components(x.type) * static_cast<size_t>(x.layers * h);
  // Columns whose source is inside.
  const int64_t first = std::clamp<int64_t>(-dx, 0, w), end = std::clamp<int64_t>(w - dx, first, w);
  const size_t rows_per_task = std::max<size_t>(1, kTask / static_cast<size_t>(w));
  workers.run((rows + rows_per_task - 1) / rows_per_task, [&](size_t task, size_t) {
    for (size_t row = task * rows_per_task; row < std::min(rows, (task + 1) * rows_per_task); ++row) {
      const int64_t y = static_cast<int64_t>(row) % h;
      double* out = result.data.data() + row * static_cast<size_t>(w);
      if (y + dy < 0 || y + dy >= h) {
        std::fill_n(out, w, 0.0);
        continue;
      }
      const double* in = x.data.data() + (static_cast<int64_t>(row) + dy) * w;
      std::fill(out, out + first, 0.0);
      if (first < end) std::copy(in + first + dx, in + end + dx, out + first);
      std::fill(out + end, out + w, 0.0);
    }
  });
}

void stretch(const Image& x, Image& result, Workers& workers) {
  const Size size = size_of(result);
  const size_t count = size.count(), planes = components(x.type);
  for_batches(workers, count, [&](size_t begin, size_t n, size_t) {
    std::vector<double> scratch(planes * n);
    const double* values = fetch_range(x, size, begin, n, scratch.data());
    for (size_t c = 0; c < planes; ++c) std::copy_n(values + c * n, n, result.data.data() + c * count + begin);
  });
}

// --- reductions ---

// Folds `n` rows of `width` numbers, `stride` apart, into `out`: halves first, so that rounding errors grow with the
// logarithm of n.
template <class Combine>
void fold_rows(const double* in, size_t n, size_t stride, size_t width, double* out, const Combine& combine) {
  constexpr size_t kLeaf = 8;
  if (n <= kLeaf) {
    std::copy_n(in, width, out);
    for (size_t r = 1; r < n; ++r) {
      for (size_t i = 0; i < width; ++i) out[i] = combine(out[i], in[r * stride + i]);
    }
    return;
  }
  constexpr size_t kWidth = 64;
  DR_ASSERT(width <= kWidth);
  const size_t half = std::bit_ceil(n) / 2;
  double second[kWidth];
  fold_rows(in, half, stride, width, out, combine);
  fold_rows(in + half * stride, n - half, stride, width, second, combine);
  for (size_t i = 0; i < width; ++i) out[i] = combine(out[i], second[i]);
}

// Takes away the middle axis of outer * n * inner numbers.
template <class Combine>
std::vector<double> fold_axis(const std::vector<double>& in, size_t outer, size_t n, size_t inner, Workers& workers,
                              const Combine& combine) {
  constexpr size_t kWidth = 64;
  std::vector<double> out(outer * inner);
  const size_t pieces = (inner + kWidth - 1) / kWidth;
  const size_t folds = outer * pieces;
  const size_t folds_per_task = std::max<size_t>(1, kTask / (n * std::min(inner, kWidth)));
  workers.run((folds + folds_per_task - 1) / folds_per_task, [&](size_t task, size_t) {
    for (size_t f = task * folds_per_task; f < std::min(folds, (task + 1) * folds_per_task); ++f) {
      const size_t o = f / pieces, begin = f % pieces * kWidth;
      fold_rows(in.data() + o * n * inner + begin, n, inner, std::min(kWidth, inner - begin),
                out.data() + o * inner + begin, combine);
    }
  });
  return out;
}

template <class Combine>
void reduce(const Op& op, const Image& x, Image& result, Workers& workers, const Combine& combine) {
  const Size size = size_of(x);
  const auto w = static_cast<size_t>(size.w), h = static_cast<size_t>(size.h), l = static_cast<size_t>(size.l);
  const size_t planes = components(x.type);
  std::vector<double> reduced;
  const std::vector<double>* now = &x.data;
  const auto take_away = [&](size_t outer, size_t n, size_t inner) {
    if (n == 1) return;
    reduced = fold_axis(*now, outer, n, inner, workers, combine);
    now = &reduced;
  };
  const bool over_x = op.attrs.ints[0] != 0, over_y = op.attrs.ints[1] != 0;
  if (over_x) take_away(planes * l * h, w, 1);
  if (over_y) take_away(planes * l, h, over_x ? 1 : w);
  if (op.attrs.ints[2] != 0) take_away(planes, l, (over_x ? 1 : w) * (over_y ? 1 : h));
  DR_ASSERT(now->size() == result.data.size());
  std::copy(now->begin(), now->end(), result.data.begin());
}

void reduce_extreme(const Op& op, ir::Yield how, const Image& x, Image& result, Workers& workers,
                    double (*fold)(double, double)) {
  // A NaN loses against the start, as it does in a loop that goes through all elements one by one.
  const double start = fold_start(how, result.type.scalar);
  reduce(op, x, result, workers, [=](double a, double b) { return fold(fold(start, a), b); });
  for (double& v : result.data) v = fold(start, v);
}

}  // namespace

void run_image_op(const Context& context, const Op& op, Image& result, Workers& workers) {
  const auto operand = [&](size_t k) -> const Image& { return *context.images[op.operands[k].index]; };
  switch (op.kind) {
    case OpKind::Const:
      std::copy(op.attrs.floats.begin(), op.attrs.floats.end(), result.data.begin());
      if (context.float32 && result.type.is_float()) round_to_float(result.data.data(), result.data.size());
      return;
    case OpKind::Coord: coord(op, result, workers); return;
    case OpKind::DimValue:
      result.data[0] = wrap(static_cast<double>(op.attrs.dims[0].evaluate(context.symbols).value()), ir::Scalar::Int);
      return;
    case OpKind::StepIndex: result.data[0] = wrap(static_cast<double>(context.step_index), ir::Scalar::Int); return;
    case OpKind::Gather: gather(operand(0), operand(1), result, workers); return;
    case OpKind::ScatterAdd:
    case OpKind::ScatterMax:
      scatter(op.kind == OpKind::ScatterMax, operand(0), operand(1), result, workers);
      if (context.float32 && result.type.is_float()) round_to_float(result.data.data(), result.data.size());
      return;
    case OpKind::Shift: shift(op, operand(0), result, workers); return;
    case OpKind::Broadcast: stretch(operand(0), result, workers); return;
    case OpKind::ReduceSum: {
      const ir::Scalar scalar = result.type.scalar;
      if (scalar == ir::Scalar::Float && context.float32) {
        reduce(op, operand(0), result, workers,
               [](double a, double b) { return static_cast<double>(static_cast<float>(a + b)); });
      } else if (scalar == ir::Scalar::Float) {
        reduce(op, operand(0), result, workers, [](double a, double b) { return a + b; });
      } else {
        reduce(op, operand(0), result, workers, [scalar](double a, double b) { return wrap(a + b, scalar); });
      }
      return;
    }
    case OpKind::ReduceMin: reduce_extreme(op, ir::Yield::Min, operand(0), result, workers, fold_min); return;
    case OpKind::ReduceMax: reduce_extreme(op, ir::Yield::Max, operand(0), result, workers, fold_max); return;
    case OpKind::Detach:
    case OpKind::Pin:
#define DR_OP(kind, name)
#define DR_ELEMENTWISE(kind, name) case OpKind::kind:
#include "compiler/ir/op_kinds.def"
#undef DR_OP
      elementwise(context, op, result, workers);
      return;
    case OpKind::Leaf:
    case OpKind::If:
    case OpKind::Reduce:
    case OpKind::Fold:
    case OpKind::Raster:
    case OpKind::Grad:
    case OpKind::Vjp:
    case OpKind::Cotangent: DR_ICE("op '" + std::string(ir::op_name(op.kind)) + "' is computed elsewhere");
  }
}

}  // namespace dr::reference
