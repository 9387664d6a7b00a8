// SPDX-License-Identifier: Apache-2.0
#include "tests/unit/passes/random_graph.h"

#include <array>
#include <random>

#include "compiler/ops/emit.h"

namespace dr::passes_test {

using namespace ir;
namespace ops = dr::ops;

namespace {

constexpr Type kVec3 = vec(3);

// What can be used at some place: the values of each type, and the domain that they stretch to.
struct Scope {
  Extent domain;
  bool root = false;
  int depth = 0;
  std::vector<ValueId> floats, ints, bools, vectors;
};

class Generator {
 public:
  Generator(uint64_t seed, const std::array<int64_t, 3>& sizes) : random_(seed) {
    root_.domain = {sizes[0], sizes[1], sizes[2]};
    root_.root = true;
  }

  Graph make() {
    for (const char* name : {"f0", "f1", "f2"}) leaf(name, kFloat);
    for (const char* name : {"i0", "i1"}) leaf(name, kInt);
    leaf("b0", kBool);
    leaf("v0", kVec3);
    const int count = pick(10, 60);
    for (int i = 0; i < count; ++i) step(root_);

    Step run{"run", {}, {}};
    for (int i = 0; i < 6; ++i) {
      const std::vector<ValueId>& from =
          *std::vector{&root_.floats, &root_.ints, &root_.bools, &root_.vectors}[pick_index(4)];
      run.outputs.push_back(
          {"out" + std::to_string(i), from[from.size() - 1 - pick_index(std::min<size_t>(from.size(), 8))]});
    }
    b_.graph().steps.push_back(std::move(run));
    return std::move(b_).finish();
  }

 private:
  int pick(int low, int high) { return low + static_cast<int>(random_() % static_cast<uint64_t>(high - low + 1)); }
  size_t pick_index(size_t count) { return static_cast<size_t>(random_() % count); }
  bool chance(int percent) { return pick(1, 100) <= percent; }

  Extent any_extent(const Extent& within) {
    const auto axis = [&](const Dim& d) { return chance(50) ? d : Dim(1); };
    return {axis(within.w), axis(within.h), axis(within.l)};
  }

  void leaf(const std::string& name, Type type) {
    const Extent extent = any_extent(root_.domain);
    b_.graph().leaves.push_back({Leaf::Kind::Input, name, type, extent, {}, {}});
    const ValueId id = ops::emit(b_, OpKind::Leaf, {}, {.text = name});
    file(root_, id);
  }

  void file(Scope& scope, ValueId id) {
    const Type type = b_.value(id).type;
    (type == kFloat  ? scope.floats
     : type == kInt  ? scope.ints
     : type == kBool ? scope.bools
                     : scope.vectors)
        .push_back(id);
    if (chance(15)) b_.set_name(id, std::string("n") + std::to_string(pick(0, 9)));
  }

  ValueId constant(Type type) {
    if (type == kBool) return ops::constant(b_, type, pick(0, 1));
    static constexpr double kNumbers[] = {0, 0, 1, 1, -1, 2, 3};
    if (type == kInt) return ops::constant(b_, type, kNumbers[pick_index(7)]);
    return ops::constant(b_, type, chance(10) ? -0.0 : chance(15) ? 0.5 : kNumbers[pick_index(7)]);
  }

  ValueId any(Scope& scope, Type type) {
    std::vector<ValueId>& from = type == kFloat  ? scope.floats
                                 : type == kInt  ? scope.ints
                                 : type == kBool ? scope.bools
                                                 : scope.vectors;
    if (from.empty() || chance(25)) {
      const ValueId id = constant(type);
      from.push_back(id);
      return id;
    }
    // The newest ones more often, so that chains grow.
    return chance(50) ? from[from.size() - 1 - pick_index(std::min<size_t>(3, from.size()))]
                      : from[pick_index(from.size())];
  }

  ValueId op(OpKind kind, std::vector<ValueId> operands, Attrs attrs = {}) {
    return ops::emit(b_, kind, std::move(operands), std::move(attrs));
  }
  ValueId real(Scope& s) { return any(s, kFloat); }
  ValueId integer(Scope& s) { return any(s, kInt); }
  ValueId boolean(Scope& s) { return any(s, kBool); }

  // Keeps numbers small, or they stop being exact.
  ValueId tame(ValueId x) {
    if (b_.value(x).type == kInt) return op(OpKind::Mod, {x, ops::constant(b_, kInt, 64.0)});
    if (b_.value(x).type == kBool) return x;
    return op(OpKind::Clamp, {op(OpKind::Floor, {x}), ops::constant(b_, b_.value(x).type, -32.0),
                              ops::constant(b_, b_.value(x).type, 32.0)});
  }

  ValueId elementwise(Scope& s) {
    const Type type = chance(30) ? kVec3 : kFloat;
    const auto number = [&] { return any(s, type); };
    switch (pick(0, 27)) {
      case 0: return op(OpKind::Add, {number(), number()});
      case 1: return op(OpKind::Sub, {number(), number()});
      case 2: return tame(op(OpKind::Mul, {number(), number()}));
      case 3: return tame(op(OpKind::SMul, {number(), number()}));
      case 4: return op(OpKind::Div, {number(), ops::constant(b_, type, 1.0)});
      case 5: return op(OpKind::Neg, {number()});
      case 6: return op(OpKind::Neg, {op(OpKind::Neg, {number()})});
      case 7: return op(OpKind::Max, {number(), number()});
      case 8: return op(OpKind::Abs, {number()});
      case 9: return op(OpKind::Select, {boolean(s), number(), number()});
      case 10: return op(OpKind::Select, {boolean(s), integer(s), integer(s)});
      case 11: return op(chance(50) ? OpKind::Less : OpKind::Equal, {real(s), real(s)});
      case 12: return op(chance(50) ? OpKind::LessEqual : OpKind::NotEqual, {integer(s), integer(s)});
      case 13: return op(OpKind::LogicalAnd, {boolean(s), boolean(s)});
      case 14: return op(OpKind::LogicalOr, {boolean(s), boolean(s)});
      case 15: return op(chance(50) ? OpKind::LogicalNot : OpKind::Unlikely, {boolean(s)});
      case 16: return op(OpKind::BitNot, {integer(s)});
      case 17: return op(chance(50) ? OpKind::BitXor : OpKind::BitAnd, {integer(s), integer(s)});
      case 18: return op(OpKind::Add, {integer(s), integer(s)});
      case 19: return tame(op(OpKind::Mul, {integer(s), integer(s)}));
      case 20: return op(OpKind::Convert, {integer(s)}, {.ints = {static_cast<int64_t>(Scalar::Float)}});
      case 21: return op(OpKind::Convert, {real(s)}, {.ints = {static_cast<int64_t>(Scalar::Int)}});
      case 22: return ops::splat(b_, real(s), 3);
      case 23: return ops::extract(b_, any(s, kVec3), pick(0, 2));
      case 24: return ops::compose(b_, {real(s), real(s), real(s)}, kVec3);
      case 25: {
        const ValueId v = any(s, kVec3);
        return ops::compose(
            b_, {ops::extract(b_, v, 0), ops::extract(b_, v, 1), ops::extract(b_, v, chance(80) ? 2 : 0)}, kVec3);
      }
      case 26: return op(chance(50) ? OpKind::Detach : OpKind::Pin, {number()});
      default: return tame(number());
    }
  }

  // An index into an image, from the scope's integers.
  ValueId index(Scope& s, const Extent& image) {
    // A number names the column only: the layer is the element's own.
    if (image.h.is_one() && (image.l.is_one() || image.l == s.domain.l) && chance(60)) return integer(s);
    return ops::compose(b_, {integer(s), integer(s), integer(s)}, vec(3, Scalar::Int));
  }

  ValueId image_op(Scope& s) {
    const Type type = chance(30) ? kVec3 : kFloat;
    const ValueId x = any(s, type);
    const Extent extent = b_.value(x).extent;
    switch (pick(0, 5)) {
      case 0: return op(OpKind::Gather, {x, index(s, extent)});
      case 1: return op(OpKind::Shift, {x}, {.ints = {pick(-1, 1), pick(-1, 1)}});
      case 2:
        return tame(op(chance(60) ? OpKind::ReduceSum : OpKind::ReduceMax, {x},
                       {.ints = {pick(0, 1), pick(0, 1), pick(0, 1)}}));
      case 3: {
        const Extent image = any_extent(root_.domain);
        return tame(op(OpKind::ScatterAdd,
                       {ops::compose(b_, {integer(s), integer(s), integer(s)}, vec(3, Scalar::Int)), x},
                       {.dims = {image.w, image.h, image.l}}));
      }
      default: return ops::broadcast(b_, x, *broadcast(extent, any_extent(root_.domain)));
    }
  }

  Scope inner_scope(const Scope& outer, const Extent& domain) {
    Scope scope{domain, false, outer.depth + 1, {}, {}, {}, {}};
    const auto fitting = [&](const std::vector<ValueId>& from, std::vector<ValueId>& to) {
      for (ValueId id : from) {
        if (broadcast(b_.value(id).extent, domain) == domain && chance(70)) to.push_back(id);
      }
    };
    fitting(outer.floats, scope.floats);
    fitting(outer.ints, scope.ints);
    fitting(outer.bools, scope.bools);
    fitting(outer.vectors, scope.vectors);
    return scope;
  }

  // Whether scatters go to these images; each yields index and value, or an accumulation of a region inside.
  struct Plan {
    std::vector<Yield> yields;
    std::vector<Type> types;
    std::vector<Extent> images;
  };

  Plan plan(bool reduce) {
    Plan p;
    for (int i = pick(1, 3); i > 0; --i) {
      const int what = pick(0, 3);
      const Yield folds[] = {Yield::Sum, Yield::Min, Yield::Max, Yield::ArgMin};
      if (what == 0) {
        p.yields.push_back(Yield::Scatter);
        p.images.push_back(any_extent(root_.domain));
        p.types.push_back(kFloat);
      } else {
        p.yields.push_back(reduce ? folds[pick_index(4)] : Yield::Element);
        p.types.push_back(!reduce && chance(30) ? kInt : kFloat);
      }
    }
    return p;
  }

  std::vector<ValueId> body(Scope& scope, const Plan& p) {
    for (int i = pick(0, 6); i > 0; --i) step(scope);
    std::vector<ValueId> yields;
    size_t scatters = 0;
    for (size_t k = 0; k < p.yields.size(); ++k) {
      if (p.yields[k] != Yield::Scatter) {
        yields.push_back(any(scope, p.types[k]));
        continue;
      }
      const Extent& image = p.images[scatters++];
      if (scope.depth < 3 && chance(40)) {
        const Plan only{{Yield::Scatter}, {p.types[k]}, {image}};
        yields.push_back(chance(60) ? make_if(scope, only)[0] : make_reduce(scope, only)[0]);
      } else {
        yields.push_back(ops::compose(b_, {integer(scope), integer(scope), integer(scope)}, vec(3, Scalar::Int)));
        yields.push_back(any(scope, p.types[k]));
      }
    }
    return yields;
  }

  Attrs attrs(const Extent& domain, const Plan& p) {
    Attrs a{.dims = {domain.w, domain.h, domain.l}, .yields = p.yields};
    for (const Extent& image : p.images) a.dims.insert(a.dims.end(), {image.w, image.h, image.l});
    return a;
  }

  Extent sub_domain(const Scope& outer) { return chance(70) ? outer.domain : any_extent(outer.domain); }

  std::vector<ValueId> make_if(Scope& outer, const Plan& p) {
    const Extent domain = sub_domain(outer);
    Scope then_scope = inner_scope(outer, domain), else_scope = inner_scope(outer, domain);
    const ValueId condition = then_scope.bools.empty() || chance(40) ? constant(kBool) : then_scope.bools.back();
    const RegionId then_region = b_.begin_region({});
    b_.end_region(body(then_scope, p));
    const RegionId else_region = b_.begin_region({});
    b_.end_region(body(else_scope, p));
    return ops::emit_multi(b_, OpKind::If, {condition}, attrs(domain, p), {then_region, else_region});
  }

  std::vector<ValueId> make_reduce(Scope& outer, const Plan& p) {
    const Extent domain = sub_domain(outer);
    Scope scope = inner_scope(outer, domain);
    const ValueId begin = ops::constant(b_, kInt, pick(0, 1));
    ValueId end = ops::constant(b_, kInt, pick(0, 3));
    if (!scope.ints.empty() && chance(50)) end = op(OpKind::BitAnd, {scope.ints[0], ops::constant(b_, kInt, 3.0)});
    const ResultType trip{kInt, domain};
    const RegionId region = b_.begin_region({&trip, 1});
    scope.ints.push_back(b_.graph().region(region).params[0]);
    b_.end_region(body(scope, p));
    Attrs a = attrs(domain, p);
    a.ints = {-1};
    return ops::emit_multi(b_, OpKind::Reduce, {begin, end}, std::move(a), {region});
  }

  // A Fold of one sweep, with states and whatever else it may give.
  void make_fold(Scope& outer) {
    const Extent domain = sub_domain(outer);
    Scope scope = inner_scope(outer, domain);
    std::vector<ValueId> operands{ops::constant(b_, kInt, pick(0, 1)), ops::constant(b_, kInt, pick(0, 3))};
    if (!scope.ints.empty() && chance(50))
      operands[1] = op(OpKind::BitAnd, {scope.ints[0], ops::constant(b_, kInt, 3.0)});
    Plan p;
    std::vector<ResultType> params{{kInt, domain}};
    for (int i = pick(1, 3); i > 0; --i) {
      const Type type = std::array{kFloat, kInt, kVec3}[pick_index(3)];
      operands.push_back(any(scope, type));
      params.push_back({type, domain});
      p.types.push_back(type);
      p.yields.push_back(Yield::Element);
    }
    const auto states = static_cast<int64_t>(p.types.size());
    for (int i = pick(0, 2); i > 0; --i) {
      const bool scatter = chance(50);
      p.yields.push_back(scatter ? Yield::Scatter : Yield::Sum);
      p.types.push_back(kFloat);
      if (scatter) p.images.push_back(any_extent(root_.domain));
    }
    const RegionId region = b_.begin_region(params);
    const std::vector<ValueId> given = b_.graph().region(region).params;
    for (const ValueId id : given) file(scope, id);
    std::vector<ValueId> yields = body(scope, p);
    for (size_t k = 0; k < static_cast<size_t>(states); ++k) yields[k] = tame(yields[k]);
    const bool stops = chance(50);
    if (stops) yields.insert(yields.begin(), boolean(scope));
    b_.end_region(std::move(yields));
    Attrs a = attrs(domain, p);
    a.ints = {chance(50) ? -1 : pick(0, 4), stops ? 1 : 0, states};
    const std::vector<ValueId> results = ops::emit_multi(b_, OpKind::Fold, std::move(operands), std::move(a), {region});
    for (size_t k = 0; k < results.size(); ++k) {
      if (p.yields[k] == Yield::Scatter && !outer.root) continue;  // may only be yielded on
      file(outer, tame(results[k]));
    }
  }

  void step(Scope& scope) {
    const int choice = pick(1, 100);
    if (choice <= 4 && scope.depth < 3) {
      make_fold(scope);
    } else if (choice <= 14 && scope.depth < 3) {
      const bool reduce = chance(40);
      const Plan p = plan(reduce);
      const std::vector<ValueId> results = reduce ? make_reduce(scope, p) : make_if(scope, p);
      for (size_t k = 0; k < results.size(); ++k) {
        if (p.yields[k] == Yield::Scatter && !scope.root) continue;  // may only be yielded on
        file(scope, tame(results[k]));
      }
    } else if (choice <= 30) {
      if (scope.root) {
        file(scope, image_op(scope));
      } else {
        const ValueId image = root_.floats[pick_index(root_.floats.size())];
        file(scope, op(OpKind::Gather, {image, index(scope, b_.value(image).extent)}));
      }
    } else if (choice <= 36) {
      file(scope, ops::coord(b_, pick(0, 2), scope.domain));
    } else {
      file(scope, elementwise(scope));
    }
  }

  std::mt19937_64 random_;
  Builder b_;
  Scope root_;
};

}  // namespace

Graph random_graph(uint64_t seed, const std::array<int64_t, 3>& sizes) { return Generator(seed, sizes).make(); }

}  // namespace dr::passes_test
