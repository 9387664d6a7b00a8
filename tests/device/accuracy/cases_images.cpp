// SPDX-License-Identifier: Apache-2.0
// The accuracy table of vectors, images, regions and sources.
#include "tests/device/accuracy/table.h"
#include "tests/gradient/build.h"

namespace dr::accuracy {

namespace {

using gradient_test::make_fold;
using gradient_test::make_if;
using gradient_test::make_reduce;
using gradient_test::Trip;
using ir::Yield;

constexpr Type kVec3 = ir::vec(3);
const std::string kMoves = "moves numbers";
const std::string kTree = "a tree of sums, of what is added up";

Case moving(Case c, size_t derivatives = 1) {
  c.bound = 0;
  c.why = kMoves;
  for (size_t k = 0; k < derivatives; ++k) c.derivatives.push_back({k, 0, kMoves});
  return c;
}

// A copy: the graph's own moves while ops are added.
ir::Extent extent_of(const Builder& b, ValueId x) { return b.value(x).extent; }

ValueId length(Builder& b, ValueId x) { return ops::emit(b, OpKind::Length, {x}); }
ValueId sum(Builder& b, ValueId x, std::vector<int64_t> axes) {
  return ops::emit(b, OpKind::ReduceSum, {x}, ints(std::move(axes)));
}

std::vector<Case> vectors() {
  std::vector<Case> all;
  // The sum of a vector's adjoints: against their sizes.
  Case splat = plain(OpKind::Splat, {all_floats()}, ints({3}));
  splat.derivatives = {{0, 1, "two sums, of what is added up",
                        [](Builder& b, const Values&, ValueId w) {
                          return ops::emit(b, OpKind::Dot, {abs_of(b, w), ops::constant(b, kVec3, 1.0)});
                        },
                        "the adjoints' sizes"}};
  all.push_back(splat);
  all.push_back(moving(plain(OpKind::Compose, {all_floats(), all_floats(), all_floats()}, ints({3, 1})), 3));
  Case matrix = moving(plain(OpKind::Compose, {all_floats(kVec3), all_floats(kVec3)}, ints({3, 2})), 2);
  matrix.name = "compose mat2x3";
  all.push_back(matrix);
  all.push_back(moving(plain(OpKind::Extract, {all_floats(kVec3)}, ints({2}))));
  for (const int n : {2, 3, 4}) {
    const Type type = ir::vec(n);
    Case dot = plain(OpKind::Dot, {all_floats(type), all_floats(type)});
    dot.name += " " + type.str();
    dot.bound = 2;
    dot.why = "three roundings, of the terms' sizes";
    dot.scale = [](Builder& b, const Values& xs, ValueId) {
      return ops::emit(b, OpKind::Dot, {abs_of(b, xs[0]), abs_of(b, xs[1])});
    };
    dot.scale_text = "the terms' sizes";
    dot.derivatives = {{0, 0.5, "one rounding"}, {1, 0.5, "one rounding"}};
    all.push_back(dot);
  }
  Case size = plain(OpKind::Length, {all_floats(kVec3)});
  size.derivatives = {{0, 7, "of normalize; one product"}};
  all.push_back(size);
  Case normal = plain(OpKind::Normalize, {all_floats(kVec3)});
  normal.derivatives = {{0, 8, "a projection: of its terms",
                         [](Builder& b, const Values& xs, ValueId w) {
                           return ops::splat(b, ops::div(b, length(b, w), length(b, xs[0])), 3);
                         },
                         "the adjoint by the length"}};
  all.push_back(normal);
  return all;
}

// Reading and writing at places of which some are outside.
std::vector<Case> places() {
  const Operand place{.type = kInt, .low = -8, .high = kWidth + 8};
  const auto index = [](Builder& b, ValueId column) {
    return ops::compose(b, {column, ops::coord(b, 1, extent_of(b, column))}, ir::vec(2, Scalar::Int));
  };
  const auto scattered = [index](Builder& b, const Values& xs, ValueId v) {
    const ir::Extent e = extent_of(b, xs[0]);
    return ops::emit(b, OpKind::ScatterAdd, {index(b, xs[0]), v}, gradient_test::dims(e));
  };
  // Fixed point adds within 2^-36 of the largest contribution of all: 2^-12 of it in last places.
  const auto terms = [scattered](Builder& b, const Values& xs, ValueId v) {
    const ValueId sizes = abs_of(b, v);
    const ValueId largest = ops::emit(b, OpKind::ReduceMax, {sizes}, ints({1, 1, 1}));
    return ops::add(b, scattered(b, xs, sizes), ops::mul(b, largest, ops::constant(b, kFloat, 0x1p-12)));
  };
  std::vector<Case> all;
  Case gather = plain(OpKind::Gather, {place, all_floats()});
  gather.bound = 0;
  gather.why = kMoves;
  gather.domain = "places of the row, some outside";
  gather.build = [index](Builder& b, const Values& xs) {
    return ops::emit(b, OpKind::Gather, {xs[1], index(b, xs[0])});
  };
  gather.derivatives = {{1, 1, "fixed point, rounded once",
                         [terms](Builder& b, const Values& xs, ValueId w) { return terms(b, xs, w); },
                         "the terms' sizes, 2^-12 of the largest"}};
  all.push_back(gather);

  Case scatter = plain(OpKind::ScatterAdd, {place, floats(-8, 8, 0x1p-20)});
  scatter.bound = 1;
  scatter.why = "fixed point, rounded once";
  scatter.domain = "places of the row, some outside";
  scatter.build = [scattered](Builder& b, const Values& xs) { return scattered(b, xs, xs[1]); };
  scatter.scale = [terms](Builder& b, const Values& xs, ValueId) { return terms(b, xs, xs[1]); };
  scatter.mixes = true;
  scatter.scale_text = "the terms' sizes, 2^-12 of the largest";
  scatter.derivatives = {{1, 0, kMoves}};
  all.push_back(scatter);

  Case most = plain(OpKind::ScatterMax, {place, words(kInt)});
  most.bound = 0;
  most.why = "integers are exact";
  most.domain = "places of the row, some outside";
  most.build = [index](Builder& b, const Values& xs) {
    return ops::emit(b, OpKind::ScatterMax, {index(b, xs[0]), xs[1]}, gradient_test::dims(extent_of(b, xs[0])));
  };
  all.push_back(most);
  all.push_back(moving(plain(OpKind::Shift, {all_floats()}, ints({3, -1}))));
  return all;
}

std::vector<Case> reductions() {
  std::vector<Case> all;
  const Operand numbers = floats(-1e6, 1e6);
  for (const auto& [name, axes] : std::vector<std::pair<std::string, std::vector<int64_t>>>{
           {"reduce_sum rows", {1, 0, 0}}, {"reduce_sum columns", {0, 1, 0}}, {"reduce_sum all", {1, 1, 1}}}) {
    Case c = plain(OpKind::ReduceSum, {numbers}, ints(axes));
    c.name = name;
    c.mixes = true;
    c.bound = 3.35;
    c.why = "2e-7 of the terms' sizes: " + kTree;
    c.scale = [axes = axes](Builder& b, const Values& xs, ValueId) { return sum(b, abs_of(b, xs[0]), axes); };
    c.scale_text = "the terms' sizes";
    c.derivatives = {{0, 0, kMoves}};
    all.push_back(c);
  }
  for (const OpKind kind : {OpKind::ReduceMin, OpKind::ReduceMax}) {
    Case c = plain(kind, {all_floats()}, ints({1, 0, 0}));
    c.bound = 0;
    c.why = "selects a number";
    c.derivatives = {{0, 4, "a share: one over how many are equal"}};
    all.push_back(c);
  }
  Case stretch = plain(OpKind::Broadcast, {all_floats()});
  stretch.build = [](Builder& b, const Values& xs) {
    ir::Extent extent = extent_of(b, xs[0]);
    extent.l = ir::Dim(3);
    return ops::broadcast(b, xs[0], extent);
  };
  stretch.bound = 0;
  stretch.why = kMoves;
  stretch.derivatives = {{0, 3.35, kTree,
                          [](Builder& b, const Values&, ValueId w) {
                            return sum(b, abs_of(b, w), {0, 0, 1});
                          },
                          "the terms' sizes"}};
  all.push_back(stretch);
  return all;
}

std::vector<Case> regions() {
  std::vector<Case> all;
  Case branch = plain(OpKind::If, {words(kBool), all_floats(), all_floats()});
  branch.build = [](Builder& b, const Values& xs) {
    return make_if(
        b, xs[0], extent_of(b, xs[0]), {Yield::Element}, [&] { return Values{ops::neg(b, xs[1])}; },
        [&] { return Values{abs_of(b, xs[2])}; })[0];
  };
  branch.bound = 0;
  branch.why = kMoves;
  branch.derivatives = {{1, 0, kMoves}, {2, 0, kMoves}};
  all.push_back(branch);

  // Up to eight trips of x over trip + 1.
  const Operand trips{.type = kInt, .low = -2, .high = 8};
  const auto fold = [](Yield yield, bool sizes) {
    return [yield, sizes](Builder& b, const Values& xs, ValueId) {
      const ValueId zero = ops::constant(b, kInt, 0.0);
      const ValueId end = ops::emit(b, OpKind::Min, {xs[0], ops::constant(b, kInt, 8.0)});
      return make_reduce(b, zero, end, extent_of(b, xs[0]), {yield}, [&](ValueId i) {
        const ValueId count = ops::emit(b, OpKind::Convert, {ops::add(b, i, ops::constant(b, kInt, 1.0))},
                                        ints({static_cast<int64_t>(Scalar::Float)}));
        const ValueId term = ops::sub(b, ops::mul(b, xs[1], count), xs[2]);
        return Values{sizes ? ops::add(b, abs_of(b, ops::mul(b, xs[1], count)), abs_of(b, xs[2])) : term};
      })[0];
    };
  };
  // Powers: each trip rounds once, and hands its error on.
  Case powers = plain(OpKind::Fold, {trips, floats(0.5, 2), floats(0.5, 2)});
  // Factors are held, since what comes between would overflow where the result need not.
  powers.domain = "up to eight trips; a factor beyond 2 counts as 2";
  powers.build = [](Builder& b, const Values& xs) {
    const ValueId factor =
        ops::emit(b, OpKind::Clamp, {xs[2], ops::constant(b, kFloat, -2.0), ops::constant(b, kFloat, 2.0)});
    return make_fold(
        b, ops::constant(b, kInt, 0.0), ops::emit(b, OpKind::Min, {xs[0], ops::constant(b, kInt, 8.0)}),
        extent_of(b, xs[0]), {xs[1]},
        [&](ValueId, const Values& states) {
          return Trip{{}, {ops::mul(b, states[0], factor)}};
        },
        8)[0];
  };
  powers.bound = 8;
  powers.why = "eight products one after another";
  powers.derivatives = {{1, 8, "eight products one after another"}, {2, 24, "sums of eight products of as many"}};
  all.push_back(powers);

  for (const auto& [yield, name] : std::vector<std::pair<Yield, std::string>>{
           {Yield::Sum, "sum"}, {Yield::Min, "min"}, {Yield::Max, "max"}, {Yield::ArgMin, "argmin"}}) {
    const bool index = yield == Yield::ArgMin;
    // Terms that are exact, where their order decides.
    Case c = plain(OpKind::Reduce, index ? std::vector<Operand>{trips, words(kInt), words(kInt)}
                                         : std::vector<Operand>{trips, floats(-1e6, 1e6), floats(-1e6, 1e6)});
    c.name = "reduce " + name;
    c.domain = "up to eight trips";
    if (index) {
      c.operands = {trips, floats(-8, 8, 0x1p-20), floats(-8, 8, 0x1p-20)};
      c.build = [](Builder& b, const Values& xs) {
        return make_reduce(
            b, ops::constant(b, kInt, 0.0), ops::emit(b, OpKind::Min, {xs[0], ops::constant(b, kInt, 8.0)}),
            extent_of(b, xs[0]), {Yield::ArgMin}, [&](ValueId i) {
              const ValueId odd = ops::emit(
                  b, OpKind::Equal,
                  {ops::emit(b, OpKind::BitAnd, {i, ops::constant(b, kInt, 1.0)}), ops::constant(b, kInt, 0.0)});
              return Values{ops::select(b, odd, xs[1], xs[2])};
            })[0];
      };
      c.bound = 0;
      c.why = "a number of a trip";
      all.push_back(c);
      continue;
    }
    c.build = [f = fold(yield, false)](Builder& b, const Values& xs) { return f(b, xs, {}); };
    c.bound = yield == Yield::Sum ? 8 : 2;
    c.why = yield == Yield::Sum ? "eight sums one after another" : "the terms' own roundings";
    c.scale = fold(yield == Yield::Sum ? Yield::Sum : Yield::Max, true);
    c.scale_text = "the terms' sizes";
    if (yield == Yield::Sum)
      c.derivatives = {{1, 8, "eight sums one after another"}, {2, 8, "eight sums one after another"}};
    all.push_back(c);
  }
  return all;
}

std::vector<Case> sources() {
  std::vector<Case> all;
  Case leaf = plain(OpKind::Leaf, {all_floats()});
  leaf.build = [](Builder&, const Values& xs) { return xs[0]; };
  all.push_back(moving(leaf, 0));
  Case number = plain(OpKind::Const, {floats(0, 0)});
  number.domain = "0.1, 1e-30, 1e30, pi";
  number.build = [](Builder& b, const Values& xs) {
    return ops::broadcast(b, ops::constant(b, ir::vec(4), {0.1, 1e-30, 1e30, 3.14159265358979}), extent_of(b, xs[0]));
  };
  number.bound = 0.5;
  number.why = "the nearest float32";
  all.push_back(number);
  for (const int axis : {0, 1, 2}) {
    Case c = moving(plain(OpKind::Coord, {floats(0, 0)}), 0);
    c.name = std::string("coord ") + "xyz"[axis];
    c.build = [axis](Builder& b, const Values& xs) { return ops::coord(b, axis, extent_of(b, xs[0])); };
    all.push_back(c);
  }
  Case dim = moving(plain(OpKind::DimValue, {floats(0, 0)}), 0);
  dim.build = [](Builder& b, const Values& xs) {
    const ir::Extent e = extent_of(b, xs[0]);
    return ops::broadcast(b, ops::dim_value(b, e.h), e);
  };
  all.push_back(dim);
  Case count = moving(plain(OpKind::StepIndex, {floats(0, 0)}), 0);
  count.build = [](Builder& b, const Values& xs) {
    return ops::broadcast(b, ops::emit(b, OpKind::StepIndex, {}), extent_of(b, xs[0]));
  };
  all.push_back(count);
  for (const OpKind kind : {OpKind::Detach, OpKind::Pin})
    all.push_back(moving(plain(kind, {all_floats()}), kind == OpKind::Pin));
  return all;
}

}  // namespace

std::vector<Case> image_cases() {
  std::vector<Case> all;
  for (auto* part : {vectors, places, reductions, regions, sources})
    for (Case& c : part()) all.push_back(std::move(c));
  return all;
}

}  // namespace dr::accuracy
