// SPDX-License-Identifier: Apache-2.0
#include <array>
#include <deque>

#include "tests/bench/measure/compile_input.h"
#include "tests/gradient/build.h"

namespace dr::bench {
namespace {

using namespace gradient_test;
using ir::kFloat;
using ir::kInt;
using ir::Scalar;

const Type kVec2 = ir::vec(2);
const Type kVec3 = ir::vec(3);

// Values are drawn from the newest most of the time, so that chains grow as they do in programs.
class Generator {
 public:
  Graph make(size_t ops) {
    const Dim vertices = Dim::symbol("V"), faces = Dim::symbol("F"), width = Dim::symbol("W"),
              height = Dim::symbol("H"), views = Dim::symbol("N");
    list_ = {vertices, 1, 1};
    const std::array<Extent, 4> extents = {Extent{}, list_, Extent{width, height, 1}, Extent{width, height, views}};
    for (size_t k = 0; k < extents.size(); ++k) {
      places_[k].extent = extents[k];
      const std::string number = std::to_string(k);
      for (const auto& [name, type] : {std::pair{"number", kFloat}, {"pair", kVec2}, {"point", kVec3}}) {
        params_.push_back(leaf(b_, name + number, type, extents[k]));
        places_[k].values.push_back(params_.back());
      }
    }
    face_ = leaf(b_, "face", ir::vec(3, Scalar::Int), {faces, 1, 1});

    // What is left unused makes the loss, so that no op is in vain.
    size_t rest = 0;
    while (b_.graph().op_count() + 2 * rest < ops) {
      step();
      rest = 0;
      for (const Place& place : places_) rest += place.unused.size();
    }
    ValueId loss = ops::constant(b_, kFloat, 0.0);
    for (Place& place : places_) {
      ValueId sum = as(place.values.back(), kFloat);
      for (const ValueId value : place.unused) sum = ops::add(b_, sum, as(value, kFloat));
      loss = ops::add(b_, loss, total(b_, sum));
    }
    const std::vector<ValueId> gradients = grad(b_, loss, ops::constant(b_, kFloat, 1.0), params_);
    std::vector<std::pair<std::string, ValueId>> outputs{{"loss", loss}};
    for (size_t k = 0; k < gradients.size(); ++k) outputs.emplace_back("gradient" + std::to_string(k), gradients[k]);
    Graph graph = std::move(b_).finish();
    add_step(graph, "fit", outputs);
    return graph;
  }

 private:
  // The values of one extent, floats and vectors of floats.
  struct Place {
    Extent extent;
    std::vector<ValueId> values;
    std::deque<ValueId> unused;  // those that nothing has used yet, in order

    void add(ValueId value) {
      values.push_back(value);
      unused.push_back(value);
    }
  };

  ValueId any(const std::vector<ValueId>& from) {
    const auto count = static_cast<int>(from.size());
    const int back = random_.chance(0.9) ? random_.integer(std::min(count, 24)) : random_.integer(count);
    return from[from.size() - 1 - static_cast<size_t>(back)];
  }
  ValueId any(Place& place) {
    if (place.unused.size() < 8 || random_.chance(0.3)) return any(place.values);
    const ValueId oldest = place.unused.front();
    place.unused.pop_front();
    return oldest;
  }
  ValueId op(OpKind kind, std::vector<ValueId> operands) { return ops::emit(b_, kind, std::move(operands)); }
  ValueId like(ValueId x, double value) { return ops::constant(b_, b_.value(x).type, value); }

  ValueId as(ValueId x, Type type) {
    const Type have = b_.value(x).type;
    if (have == type) return x;
    if (!have.is_scalar()) x = ops::extract(b_, x, random_.integer(have.rows));
    return type.is_scalar() ? x : ops::splat(b_, x, type.rows);
  }

  template <class From>
  ValueId arithmetic(From& from) {
    const ValueId x = any(from);
    const ValueId y = as(any(from), b_.value(x).type);
    switch (random_.integer(16)) {
      case 0:
      case 1:
      case 2: return ops::add(b_, x, y);
      case 3:
      case 4: return ops::sub(b_, x, y);
      case 5:
      case 6:
      case 7: return ops::mul(b_, x, y);
      case 8: return ops::div(b_, x, ops::add(b_, ops::mul(b_, y, y), like(y, 1.0)));
      case 9: return ops::mul(b_, x, like(x, 0.5));
      case 10: return op(OpKind::Max, {x, like(x, 0.0)});
      case 11: return op(OpKind::Sqrt, {ops::add(b_, ops::mul(b_, x, x), like(x, 1e-4))});
      case 12: return op(random_.chance(0.5) ? OpKind::Exp : OpKind::Sigmoid, {x});
      case 13: return b_.value(x).type.is_scalar() ? op(OpKind::Sin, {x}) : op(OpKind::Dot, {x, y});
      case 14: return ops::select(b_, op(OpKind::Less, {as(x, kFloat), as(y, kFloat)}), x, y);
      default: return ops::compose(b_, {as(x, kFloat), as(y, kFloat), as(x, kFloat)}, kVec3);
    }
  }

  ValueId integer(double x) { return ops::constant(b_, kInt, x); }
  // A number near the element's own column.
  ValueId near(const Extent& extent) {
    const ValueId i = ops::add(b_, ops::coord(b_, 0, extent), integer(random_.integer(9) - 4));
    return op(OpKind::Clamp, {i, integer(0), ops::dim_value(b_, extent.w - Dim(1))});
  }
  ValueId any_vertex() { return any(places_[1]); }

  std::vector<ValueId> body(std::vector<ValueId> values, const Extent& domain, ValueId trip) {
    for (int k = 2 + random_.integer(5); k > 0; --k) {
      if (random_.chance(0.3)) {
        values.push_back(op(OpKind::Gather, {any_vertex(), trip.valid() ? trip : near(domain)}));
      } else {
        values.push_back(arithmetic(values));
      }
    }
    return {as(values.back(), kFloat), as(values[values.size() - 2], kVec3)};
  }

  void region(Place& place) {
    const std::vector<ValueId> around = {any(place), any(place), any(place)};
    std::vector<ValueId> results;
    if (random_.chance(0.6)) {
      const ValueId condition = op(OpKind::Less, {as(around[0], kFloat), as(around[1], kFloat)});
      const auto branch = [&] { return body(around, place.extent, {}); };
      results = make_if(b_, condition, place.extent, {Yield::Element, Yield::Element}, branch, branch);
    } else {
      results = make_reduce(b_, integer(0), integer(4), place.extent, {Yield::Max, Yield::Sum},
                            [&](ValueId i) { return body(around, place.extent, i); });
    }
    for (const ValueId result : results) place.add(result);
  }

  void step() {
    Place& place = places_[static_cast<size_t>(random_.integer(4))];
    const auto add = [&](ValueId value) { place.add(value); };
    const double choice = random_.real(0, 1);
    if (choice < 0.03) {
      region(place);
    } else if (choice < 0.08) {
      add(op(OpKind::Gather, {any_vertex(), near(place.extent)}));
    } else if (choice < 0.10) {
      const ValueId corner = ops::extract(b_, face_, random_.integer(3));
      const ValueId at_corner = op(OpKind::Gather, {any_vertex(), corner});
      places_[1].add(ops::emit(b_, OpKind::ScatterAdd, {corner, at_corner}, dims(list_)));
    } else if (choice < 0.13) {
      add(ops::emit(b_, OpKind::Shift, {any(place)}, ints({random_.integer(3) - 1, random_.integer(3) - 1})));
    } else if (choice < 0.15) {
      const ValueId x = any(place);
      places_[0].add(ops::emit(b_, OpKind::ReduceSum, {x}, ints({1, 1, 1})));
    } else if (choice < 0.18) {
      const ValueId x = as(any(places_[0]), kVec3);
      add(random_.chance(0.5) ? ops::broadcast(b_, x, place.extent) : ops::mul(b_, x, as(any(place), kVec3)));
    } else {
      add(arithmetic(place));
    }
  }

  Random random_{1};
  Builder b_;
  std::array<Place, 4> places_;
  Extent list_;
  ValueId face_;
  std::vector<ValueId> params_;
};

}  // namespace

Graph generated_graph(size_t ops) { return Generator().make(ops); }

}  // namespace dr::bench
