// SPDX-License-Identifier: Apache-2.0
#include "tests/gradient/random_graph.h"

#include <algorithm>
#include <array>

namespace dr::gradient_test {

using ir::kFloat;
using ir::kInt;
using ir::Scalar;
using ir::vec;

std::string leaf_name(size_t k) { return std::string("x").append(std::to_string(k)); }

namespace {

// Grows a graph from its leaves by random steps. Nothing grows without bound, and nothing is singular. All constants
// are fractions of few binary digits: `simplify` folds as a device computes, in float32, and other numbers would change
// by 1e-8 when it does.
class Generator {
 public:
  Generator(uint64_t seed, const RandomGraphOptions& options) : random_(seed), sizes_(options.sizes) {
    const int leaves = 3 + random_.integer(3);
    for (int k = 0; k < leaves; ++k) {
      const std::string name = leaf_name(static_cast<size_t>(k));
      const Type type = any_type();
      const Extent extent = any_extent();
      params_.push_back(leaf(b_, name, type, extent));
      data_.emplace(name, random_.image(type, extent, -1.5, 1.5));
    }
    pool_ = params_;
    const size_t first = b_.graph().op_count();
    if (options.long_trips > 0) {
      gradients_ = 2;  // none inside: they go through all pairs of trips
      pool_.push_back(long_loop(options.long_trips));
    }
    for (int k = 0; k < options.steps || b_.graph().op_count() < first + options.ops; ++k) step();
    // The later values hang together; a few of them make the result.
    y_ = as(pool_.back(), kFloat);
    for (int k = 0; k < 5; ++k) {
      const int among = std::min(10, static_cast<int>(pool_.size()));
      const ValueId late = pool_[pool_.size() - 1 - static_cast<size_t>(random_.integer(among))];
      y_ = ops::add(b_, y_, as(late, kFloat));
    }
  }

  RandomGraph finish() && { return {std::move(b_), std::move(params_), y_, std::move(data_), random_}; }

 private:
  Type any_type() { return random_.chance(0.5) ? kFloat : vec(2 + random_.integer(3)); }
  Extent any_extent() {
    const auto axis = [&](int64_t size) { return Dim(random_.chance(0.5) ? size : 1); };
    return {axis(sizes_[0]), axis(sizes_[1]), axis(sizes_[2])};
  }
  ValueId any() { return pool_[static_cast<size_t>(random_.integer(static_cast<int>(pool_.size())))]; }
  ValueId op(OpKind kind, std::vector<ValueId> operands) { return ops::emit(b_, kind, std::move(operands)); }
  ValueId number(double x) { return ops::constant(b_, kFloat, x); }
  ValueId integer(double x) { return ops::constant(b_, kInt, x); }
  ValueId sin(ValueId x) { return op(OpKind::Sin, {x}); }
  ValueId scaled(ValueId x, double s) { return ops::mul(b_, x, ops::constant(b_, b_.value(x).type, s)); }
  ValueId square_plus_one(ValueId x) {
    return ops::add(b_, ops::mul(b_, x, x), ops::constant(b_, b_.value(x).type, 1.0));
  }
  ValueId to_float(ValueId i) {
    return ops::emit(b_, OpKind::Convert, {i}, ints({static_cast<int64_t>(Scalar::Float)}));
  }

  // x as another type.
  ValueId as(ValueId x, Type type) {
    const Type have = b_.value(x).type;
    if (have == type) return x;
    if (!have.is_scalar())
      x = type.is_scalar() && random_.chance(0.5) ? op(OpKind::Dot, {x, scaled(x, 0.25)})
                                                  : ops::extract(b_, x, random_.integer(have.rows));
    return type.is_scalar() ? x : ops::splat(b_, x, type.rows);
  }

  // One element-wise step on values of a list; usable in the root and in regions.
  ValueId elementwise(const std::vector<ValueId>& from) {
    const auto pick = [&] { return from[static_cast<size_t>(random_.integer(static_cast<int>(from.size())))]; };
    const ValueId x = pick();
    const Type type = b_.value(x).type;
    const ValueId y = as(pick(), type);
    switch (random_.integer(22)) {
      case 0: return ops::add(b_, x, y);
      case 1: return ops::sub(b_, x, y);
      case 2:
      case 3: return sin(ops::mul(b_, x, y));
      case 4: return ops::div(b_, x, square_plus_one(y));
      case 5: return op(OpKind::Sqrt, {square_plus_one(x)});
      case 6: return op(OpKind::Exp, {ops::neg(b_, ops::mul(b_, x, x))});
      case 7: return op(OpKind::Tanh, {x});
      case 8: return op(OpKind::Sigmoid, {x});
      case 9: return op(OpKind::Log, {square_plus_one(x)});
      case 10: return op(OpKind::Abs, {x});
      case 11: return op(OpKind::Min, {x, y});
      case 12: return op(OpKind::Max, {x, y});
      case 13: return op(OpKind::Clamp, {x, ops::constant(b_, type, -0.75), ops::constant(b_, type, 0.75)});
      case 14: return ops::select(b_, op(OpKind::Less, {as(x, kFloat), as(y, kFloat)}), scaled(y, 0.5), x);
      case 15: return op(OpKind::Atan, {x});
      case 16: return op(OpKind::InverseSqrt, {square_plus_one(y)});
      case 17: {
        const std::vector<ValueId> parts{as(x, kFloat), as(y, kFloat), sin(as(x, kFloat))};
        return ops::compose(b_, parts, vec(3));
      }
      case 18:
        if (type.is_scalar()) return op(OpKind::Softplus, {x});
        return op(random_.chance(0.5) ? OpKind::Normalize : OpKind::Length,
                  {ops::add(b_, sin(x), ops::constant(b_, type, 3.0))});
      case 19: return ops::smul(b_, x, op(OpKind::Cos, {y}));
      case 20: return random_.chance(0.3) ? op(OpKind::Detach, {x}) : op(OpKind::Pin, {x});
      default: return op(OpKind::Tanh, {ops::mul(b_, x, y)});
    }
  }

  std::vector<int64_t> any_axes() { return {random_.integer(2), random_.integer(2), random_.integer(2)}; }

  // An index into x from integers that vary over `extent`, now and then outside. `here` are more integers to use.
  ValueId any_index(ValueId x, const Extent& extent, const std::vector<ValueId>& here = {}) {
    const Extent image = b_.value(x).extent;
    const auto along = [&](int axis, const Dim& size) {
      ValueId i = !here.empty() && random_.chance(0.6)
                      ? here[static_cast<size_t>(random_.integer(static_cast<int>(here.size())))]
                      : ops::coord(b_, axis, extent);
      if (random_.chance(0.5)) i = ops::mul(b_, i, integer(2 + random_.integer(3)));
      i = op(OpKind::Mod, {i, integer(static_cast<double>(size.constant() + 1))});
      return random_.chance(0.5) ? ops::sub(b_, i, integer(1)) : i;
    };
    const bool layers_agree = image.l.is_one() || image.l == extent.l;
    if (!layers_agree || random_.chance(0.3)) {
      return ops::compose(b_, {along(0, image.w), along(1, image.h), along(2, image.l)}, vec(3, Scalar::Int));
    }
    if (image.h.is_one() && random_.chance(0.7)) return along(0, image.w);
    return ops::compose(b_, {along(0, image.w), along(1, image.h)}, vec(2, Scalar::Int));
  }

  // The captured values of a region, with the domain they span. Values of other extents stay out.
  Extent region_domain() {
    Extent domain = any_extent();
    for (int k = 0; k < 2; ++k) domain = *ir::broadcast(domain, b_.value(any()).extent);
    return domain;
  }
  std::vector<ValueId> within(const Extent& domain) {
    std::vector<ValueId> fitting;
    for (const ValueId x : pool_) {
      if (ir::broadcast(domain, b_.value(x).extent) == domain) fitting.push_back(x);
    }
    if (fitting.empty()) fitting.push_back(number(0.5));
    std::vector<ValueId> chosen;
    for (int k = 0; k < 4; ++k)
      chosen.push_back(fitting[static_cast<size_t>(random_.integer(static_cast<int>(fitting.size())))]);
    return chosen;
  }

  // A region in a region may run on fewer elements, if there are values for it.
  std::pair<Extent, std::vector<ValueId>> narrowed(const Extent& domain, const std::vector<ValueId>& values) {
    Extent fewer = domain;
    for (Dim* axis : {&fewer.w, &fewer.h, &fewer.l}) {
      if (random_.chance(0.3)) *axis = Dim(1);
    }
    std::vector<ValueId> fitting;
    for (const ValueId x : values) {
      if (ir::broadcast(fewer, b_.value(x).extent) == fewer) fitting.push_back(x);
    }
    if (fitting.size() < 2) return {domain, values};
    return {fewer, fitting};
  }

  // Ops of a region: reads, element-wise steps, further regions. `trips` are the trip numbers around. Gives a value of
  // the type asked for.
  ValueId body(std::vector<ValueId> values, const std::vector<ValueId>& trips, const Extent& domain, Type type,
               int depth) {
    for (const ValueId i : trips) values.push_back(scaled(to_float(i), 0.25));
    const int count = 2 + random_.integer(4);
    for (int k = 0; k < count; ++k) {
      const double choice = random_.real(0, 1);
      if (choice < 0.35) {
        const ValueId image = any();
        values.push_back(op(OpKind::Gather, {image, any_index(image, domain, trips)}));
      } else if (choice < 0.5 && depth < 2) {
        const auto [fewer, fitting] = narrowed(domain, values);
        for (const ValueId result : region(fitting, trips, fewer, depth + 1)) values.push_back(result);
      } else {
        values.push_back(elementwise(values));
      }
    }
    const ValueId last = values.back();
    const ValueId other = values[static_cast<size_t>(random_.integer(static_cast<int>(values.size())))];
    return ops::add(b_, as(last, type), sin(as(other, type)));
  }

  std::vector<ValueId> region(const std::vector<ValueId>& values, const std::vector<ValueId>& trips,
                              const Extent& domain, int depth) {
    std::vector<ValueId> results;
    if (random_.chance(0.3)) {
      const Type first = any_type(), second = any_type();
      // Few trips: gradients of gradients go through all pairs of them.
      ValueId end = integer(1 + random_.integer(4));
      if (random_.chance(0.4)) end = op(OpKind::Mod, {ops::coord(b_, 0, domain), integer(4)});
      const bool stops = random_.chance(0.5);
      const std::vector<ValueId> starts{as(values[0], first), as(values[1], second)};
      results = make_fold(
          b_, integer(random_.integer(2)), end, domain, starts,
          [&](ValueId i, const std::vector<ValueId>& states) {
            std::vector<ValueId> inner = trips, here = values;
            inner.push_back(i);
            here.insert(here.end(), states.begin(), states.end());
            const ValueId a = body(here, inner, domain, first, depth), c = body(here, inner, domain, second, depth);
            Trip trip{{}, {op(OpKind::Tanh, {ops::add(b_, a, scaled(states[0], 0.5))}), op(OpKind::Sin, {c})}};
            if (stops) trip.stop = op(OpKind::Less, {number(0.75), as(states[1], kFloat)});
            return trip;
          },
          4);
    } else if (random_.chance(0.5)) {
      const Type first = any_type(), second = any_type();
      const ValueId condition = op(OpKind::Less, {as(values[0], kFloat), as(values[1], kFloat)});
      const auto branch = [&] {
        return std::vector{body(values, trips, domain, first, depth), body(values, trips, domain, second, depth)};
      };
      results = make_if(b_, condition, domain, {Yield::Element, Yield::Element}, branch, branch);
    } else {
      const Type summed = any_type();
      ValueId begin = integer(random_.integer(2));
      ValueId end = integer(2 + random_.integer(3));
      if (random_.chance(0.4)) end = op(OpKind::Mod, {ops::coord(b_, 0, domain), integer(4)});
      const Yield extreme = random_.chance(0.5) ? Yield::Min : Yield::Max;
      results = make_reduce(b_, begin, end, domain, {Yield::Sum, extreme}, [&](ValueId i) {
        std::vector<ValueId> inner = trips;
        inner.push_back(i);
        return std::vector{body(values, inner, domain, summed, depth), body(values, inner, domain, kFloat, depth)};
      });
      // An empty range gives an infinity.
      results[1] = op(OpKind::Clamp, {results[1], number(-5), number(5)});
      results[0] = op(OpKind::Tanh, {results[0]});
    }
    return results;
  }

  // So many trips over few elements: a sum, or a state that each trip takes a small step with.
  ValueId long_loop(int64_t trips) {
    const Extent domain = any_extent();
    const std::vector<ValueId> values = within(domain);
    const Type type = any_type();
    const ValueId begin = integer(random_.integer(2)), end = integer(static_cast<double>(trips));
    const auto term = [&](ValueId i, std::vector<ValueId> here) {
      const ValueId image = any();
      here.push_back(op(OpKind::Gather, {image, any_index(image, domain, {i})}));
      here.push_back(sin(to_float(op(OpKind::Mod, {i, integer(64)}))));
      for (int k = random_.integer(4); k >= 0; --k) here.push_back(elementwise(here));
      return as(here.back(), type);
    };
    if (random_.chance(0.5)) {
      const auto terms = [&](ValueId i) { return std::vector{term(i, values)}; };
      return scaled(make_reduce(b_, begin, end, domain, {Yield::Sum}, terms)[0], small(0.375, trips));
    }
    const auto trip = [&](ValueId i, const std::vector<ValueId>& states) {
      return Trip{{}, {op(OpKind::Tanh, {ops::add(b_, term(i, values), scaled(states[0], 0.5))})}};
    };
    return make_fold(b_, begin, end, domain, {as(values[0], type)}, trip, trips)[0];
  }

  // By a power of two: as small for many terms as it is for 24.
  static double small(double factor, int64_t terms) {
    for (; terms > 24; terms /= 2) factor *= 0.5;
    return factor;
  }
  double sum_scale() const { return small(0.375, sizes_[0] * sizes_[1] * sizes_[2]); }

  // A number that stretches to `like`, with its type and extent.
  ValueId as_extent(ValueId x, ValueId like) {
    const Extent extent = b_.value(like).extent;
    if (ir::broadcast(b_.value(x).extent, extent) != extent) x = number(0.5);
    return ops::broadcast(b_, as(x, b_.value(like).type), extent);
  }

  // A sum over products of two images at places that the element and the trip give, clamped or mirrored now and then.
  ValueId contraction() {
    const ValueId a = any(), c = any();
    const Extent domain = any_extent();
    const auto read = [&](ValueId image, ValueId trip, int own) {
      const Extent& extent = b_.value(image).extent;
      const ValueId last = integer(static_cast<double>(extent.w.constant() - 1));
      ValueId along = trip, across = ops::coord(b_, own, domain);
      if (random_.chance(0.3)) along = ops::add(b_, along, ops::coord(b_, 1 - own, domain));
      if (random_.chance(0.3)) along = ops::sub(b_, along, integer(1));
      if (random_.chance(0.3)) along = op(OpKind::Abs, {along});
      if (random_.chance(0.4)) along = op(OpKind::Clamp, {along, integer(0), last});
      if (random_.chance(0.3)) std::swap(along, across);
      const ValueId index = ops::compose(b_, {along, across, integer(0)}, vec(3, Scalar::Int));
      return as(op(OpKind::Gather, {image, index}), kFloat);
    };
    const auto trips = [&](ValueId i) { return std::vector{ops::mul(b_, read(a, i, 0), read(c, i, 1))}; };
    const ValueId end = integer(1 + random_.integer(5));
    return op(OpKind::Tanh, make_reduce(b_, integer(0), end, domain, {Yield::Sum}, trips));
  }

  // What a loop carries after each trip, along an axis that its elements leave free.
  ValueId scan() {
    Extent domain = any_extent();
    const auto free = static_cast<size_t>(random_.integer(3));
    *std::array{&domain.w, &domain.h, &domain.l}[free] = 1;
    Extent image = domain;
    const int64_t trips = sizes_[free];
    *std::array{&image.w, &image.h, &image.l}[free] = trips;
    const std::vector<ValueId> values = within(domain);
    const Type type = any_type();
    const bool stops = random_.chance(0.3);
    const int first = random_.integer(2);
    const ValueId begin = integer(first), end = integer(static_cast<double>(first + trips));
    const auto body_of = [&](ValueId i, const std::vector<ValueId>& states) {
      std::vector<ValueId> here = values, place;
      here.push_back(states[0]);
      for (size_t axis = 0; axis < 3; ++axis)
        place.push_back(axis == free ? ops::sub(b_, i, begin) : ops::coord(b_, static_cast<int>(axis), domain));
      const ValueId next = op(OpKind::Tanh, {ops::add(b_, body(here, {i}, domain, type, 1), scaled(states[0], 0.5))});
      Trip trip{{}, {next}, {ops::compose(b_, place, vec(3, Scalar::Int)), next}};
      if (stops) trip.stop = op(OpKind::Less, {number(0.75), as(next, kFloat)});
      return trip;
    };
    return make_fold(b_, begin, end, domain, {as(values[0], type)}, body_of, std::max<int64_t>(4, trips), {image})[1];
  }

  void step() {
    const ValueId x = any();
    const Extent extent = b_.value(x).extent;
    const double choice = random_.real(0, 1);
    if (choice < 0.08) {
      const OpKind kind =
          std::array{OpKind::ReduceSum, OpKind::ReduceMin, OpKind::ReduceMax}[static_cast<size_t>(random_.integer(3))];
      pool_.push_back(scaled(ops::emit(b_, kind, {x}, ints(any_axes())), sum_scale()));
    } else if (choice < 0.13) {
      pool_.push_back(ops::emit(b_, OpKind::Broadcast, {x}, dims(*ir::broadcast(extent, any_extent()))));
    } else if (choice < 0.18) {
      pool_.push_back(ops::emit(b_, OpKind::Shift, {x}, ints({random_.integer(5) - 2, random_.integer(3) - 1})));
    } else if (choice < 0.26) {
      pool_.push_back(op(OpKind::Gather, {x, any_index(x, any_extent())}));
    } else if (choice < 0.34) {
      // Into an image of its own layers, or of one.
      Extent image = any_extent();
      if (!image.l.is_one()) image.l = extent.l;
      const ValueId shaped = ops::constant(b_, kFloat, 0.0);
      const ValueId target = ops::broadcast(b_, shaped, image);
      const ValueId sum = ops::emit(b_, OpKind::ScatterAdd, {any_index(target, extent), x}, dims(image));
      pool_.push_back(sum_scale() < 0.375 ? scaled(sum, sum_scale()) : sum);
    } else if (choice < 0.48) {
      const Extent domain = region_domain();
      for (const ValueId result : region(within(domain), {}, domain, 0)) pool_.push_back(result);
    } else if (choice < 0.54 && gradients_ < 2) {
      // Large derivatives are tamed before they go on.
      ++gradients_;
      const ValueId y = any();
      for (const ValueId g : grad(b_, y, ops::constant(b_, b_.value(y).type, 0.5), {x, any()}))
        pool_.push_back(op(OpKind::Tanh, {scaled(g, 0.25)}));
    } else if (choice < 0.57 && gradients_ < 2) {
      ++gradients_;
      const ValueId y = any(), along = as_extent(any(), x);
      pool_.push_back(op(OpKind::Tanh, {scaled(jvp(b_, y, x, along), 0.25)}));
    } else if (choice < 0.63) {
      pool_.push_back(contraction());
    } else if (choice < 0.67) {
      pool_.push_back(scan());
    } else {
      pool_.push_back(elementwise(pool_));
    }
  }

  Random random_;
  std::array<int64_t, 3> sizes_;
  Builder b_;
  std::vector<ValueId> params_;
  std::vector<ValueId> pool_;
  Images data_;
  ValueId y_;
  int gradients_ = 0;
};

}  // namespace

RandomGraph random_graph(uint64_t seed, const RandomGraphOptions& options) { return Generator(seed, options).finish(); }

}  // namespace dr::gradient_test
