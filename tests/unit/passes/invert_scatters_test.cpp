// SPDX-License-Identifier: Apache-2.0
// Scatters that became gathers add the same terms: of random places in random loops, with whole numbers, whose sums are
// exact in any order.
#include <algorithm>
#include <cstdlib>
#include <random>

#include "compiler/ops/emit.h"
#include "compiler/passes/passes.h"
#include "compiler/reference/evaluate.h"
#include "tests/sanitized.h"
#include "tests/unit/passes/text.h"

using namespace dr::ir;
namespace ops = dr::ops;
namespace reference = dr::reference;

namespace {

size_t scatters(const Graph& graph) {
  size_t count = 0;
  const std::vector<bool> live = live_ops(graph, {});
  for (const OpId id : graph.region(graph.root()).ops) {
    const Op& op = graph.op(id);
    if (!live[id.index]) continue;
    count += op.kind == OpKind::ScatterAdd ? 1 : 0;
    count += static_cast<size_t>(std::ranges::count(op.attrs.yields, Yield::Scatter));
  }
  return count;
}

class RandomScatter {
 public:
  explicit RandomScatter(uint64_t seed) : random_(seed) {
    for (const char* name : {"A", "B", "C", "Q", "R", "S"}) {
      const int64_t most = name[0] == 'C' || name[0] == 'S' ? 2 : 7;
      symbols[name] = pick(1, static_cast<int>(most));
    }
    symbols["N"] = pick(1, 5);
  }

  SymbolValues symbols;

  Graph make() {
    const int layers = pick(0, 3) == 0 ? 1 : 0;
    const Extent domain{size("A"), size("B"), layers != 0 ? size("C") : Dim(1)};
    const bool own_layer = layers != 0 && pick(0, 1) == 0;
    rows_ = own_layer ? 2 : layers != 0 ? 3 : pick(1, 2);
    const Extent target{size("Q"), rows_ == 1 ? Dim(1) : size("R"),
                        own_layer    ? domain.l
                        : rows_ == 3 ? size("S")
                                     : Dim(1)};
    const ValueId v = leaf("v", kFloat, domain), c = leaf("c", kBool, domain), t = leaf("t", kFloat, target);
    for (int axis = 0; axis < 3; ++axis) integers_.push_back(ops::coord(b_, axis, domain));
    const Attrs whole{.dims = {domain.w, domain.h, domain.l}};

    ValueId result;
    const int form = pick(0, 3);
    if (form == 0) {
      const ValueId value = ops::mul(b_, v, read(t));
      result = ops::emit(b_, OpKind::ScatterAdd, {place(), value}, {.dims = {target.w, target.h, target.l}});
    } else {
      result = loops(form, domain, target, v, c, t);
    }
    b_.graph().steps.push_back({"run", {{"r", result}}, {}});
    return std::move(b_).finish();
  }

 private:
  int pick(int low, int high) { return low + static_cast<int>(random_() % static_cast<uint64_t>(high - low + 1)); }
  Dim size(const char* name) { return pick(0, 2) == 0 ? Dim(symbols.find(name)->second) : Dim::symbol(name); }
  ValueId number(int x) { return ops::constant(b_, kInt, x); }

  ValueId leaf(const char* name, Type type, const Extent& extent) {
    b_.graph().leaves.push_back(
        {.kind = Leaf::Kind::Input, .name = name, .type = type, .extent = extent, .initial = {}, .span = {}});
    const ResultType result{type, extent};
    return b_.graph().op(b_.add(OpKind::Leaf, {}, {&result, 1}, {.text = name})).results[0];
  }

  // A number made of one of the integers in a way that can mostly be undone.
  ValueId component() {
    ValueId x = pick(0, 9) == 0 ? number(pick(-1, 3))
                                : integers_[static_cast<size_t>(pick(0, static_cast<int>(integers_.size()) - 1))];
    for (int ops_left = pick(0, 3); ops_left > 0; --ops_left) x = changed(x);
    return x;
  }

  ValueId changed(ValueId x) {
    const ValueId other = pick(0, 1) == 0 ? number(pick(-3, 3))
                          : pick(0, 1) == 0
                              ? ops::dim_value(b_, Dim::symbol("Q"))
                              : integers_[static_cast<size_t>(pick(0, static_cast<int>(integers_.size()) - 1))];
    switch (pick(0, 9)) {
      case 0: return ops::add(b_, x, other);
      case 1: return ops::sub(b_, x, other);
      case 2: return ops::sub(b_, other, x);
      case 3: return ops::neg(b_, x);
      case 4:
        return ops::emit(b_, OpKind::Clamp,
                         {x, number(0), ops::sub(b_, ops::dim_value(b_, Dim::symbol("Q")), number(1))});
      case 5: return ops::emit(b_, pick(0, 1) == 0 ? OpKind::Min : OpKind::Max, {x, other});
      case 6: return ops::emit(b_, OpKind::Abs, {x});
      case 7:
        return ops::emit(b_, OpKind::Mod,
                         {x, pick(0, 1) == 0 ? ops::dim_value(b_, Dim::symbol("A")) : number(pick(1, 9))});
      case 8: return ops::mul(b_, x, number(pick(-2, 3)));
      default: return ops::emit(b_, OpKind::Div, {x, number(pick(1, 3))});
    }
  }

  ValueId place() {
    if (rows_ == 1) return component();
    std::vector<ValueId> parts;
    for (int k = 0; k < rows_; ++k) parts.push_back(component());
    const ValueId whole = ops::compose(b_, parts, vec(rows_, Scalar::Int));
    if (pick(0, 2) != 0) return whole;
    const ValueId by = ops::splat(b_, number(pick(-1, 1)), rows_);
    return ops::add(b_, whole, by);
  }

  ValueId read(ValueId t) { return ops::emit(b_, OpKind::Gather, {t, place()}); }

  ValueId loops(int form, const Extent& domain, const Extent& target, ValueId v, ValueId c, ValueId t) {
    const Attrs attrs{
        .ints = {-1}, .dims = {domain.w, domain.h, domain.l, target.w, target.h, target.l}, .yields = {Yield::Scatter}};
    const Attrs choice{.dims = attrs.dims, .yields = attrs.yields};
    const auto branch = [&](ValueId yield_value) {
      const ValueId index = place();
      b_.end_region({index, yield_value});
    };
    const auto chosen = [&] {
      const RegionId then = b_.begin_region({});
      branch(ops::mul(b_, v, read(t)));
      const RegionId otherwise = b_.begin_region({});
      branch(ops::constant(b_, kFloat, pick(0, 1)));
      return ops::emit(b_, OpKind::If, {c}, choice, {then, otherwise});
    };
    if (form == 1) return chosen();
    const ValueId begin = number(pick(0, 2) == 0 ? -1 : 0),
                  end = pick(0, 1) == 0 ? number(4) : ops::dim_value(b_, Dim::symbol("N"));
    const ResultType trip{kInt, domain};
    const RegionId body = b_.begin_region({&trip, 1});
    integers_.push_back(b_.graph().region(body).params[0]);
    if (form == 2) {
      const ValueId value = ops::mul(b_, v, read(t));
      const ValueId index = place();
      b_.end_region({index, value});
    } else if (pick(0, 1) == 0) {
      b_.end_region({chosen()});
    } else {
      const ValueId high = number(3);
      const RegionId inner = b_.begin_region({&trip, 1});
      integers_.push_back(b_.graph().region(inner).params[0]);
      const ValueId value = ops::add(b_, v, read(t));
      const ValueId index = place();
      b_.end_region({index, value});
      b_.end_region({ops::emit(b_, OpKind::Reduce, {begin, high}, attrs, {inner})});
    }
    return ops::emit(b_, OpKind::Reduce, {begin, end}, attrs, {body});
  }

  std::mt19937_64 random_;
  Builder b_;
  std::vector<ValueId> integers_;
  int rows_ = 1;
};

reference::Image run(const Graph& graph, const SymbolValues& symbols, uint64_t seed) {
  std::mt19937_64 random(seed);
  reference::Session session(graph);
  for (const auto& [name, value] : symbols)
    if (const auto error = session.bind_symbol(name, value)) FAIL(*error);
  for (const Leaf& leaf : graph.leaves) {
    const auto size = [&](const Dim& dim) { return *dim.evaluate(symbols); };
    reference::Image image = reference::zeros(leaf.type, size(leaf.extent.w), size(leaf.extent.h), size(leaf.extent.l));
    for (double& x : image.data)
      x = leaf.type.is_bool() ? static_cast<double>(random() % 2) : static_cast<double>(random() % 9) - 4;
    if (const auto error = session.bind(leaf.name, std::move(image))) FAIL(*error);
  }
  auto result = session.run("run");
  if (const auto* error = std::get_if<reference::EvalError>(&result)) FAIL(error->message);
  return std::get<reference::StepResult>(std::move(result)).outputs.at("r");
}

bool check(uint64_t seed) {
  RandomScatter random(seed);
  const Graph before = random.make();
  CAPTURE(seed, print(before));
  REQUIRE(dr::passes::verify(before) == std::vector<std::string>{});
  const Graph made = dr::passes::invert_scatters(before);
  CAPTURE(print(made));
  REQUIRE(dr::passes::verify(made) == std::vector<std::string>{});
  const Graph after = dr::passes::simplify(made);
  REQUIRE(dr::passes::verify(after) == std::vector<std::string>{});
  const reference::Image x = run(before, random.symbols, seed), y = run(after, random.symbols, seed);
  REQUIRE(x.data.size() == y.data.size());
  for (size_t i = 0; i < x.data.size(); ++i) {
    CAPTURE(i, x.data[i], y.data[i]);
    REQUIRE(x.data[i] == y.data[i]);
  }
  return scatters(after) == 0;
}

}  // namespace

TEST_CASE("random scatters that become gathers add the same terms") {
  if (const char* seed = std::getenv("DR_SEED")) {
    check(std::strtoull(seed, nullptr, 10));
    return;
  }
  int inverted = 0;
  const int tried = dr::repeats(3000);
  for (int seed = 0; seed < tried; ++seed) inverted += check(static_cast<uint64_t>(seed)) ? 1 : 0;
  CHECK(inverted > tried / 3);
  CHECK(inverted < tried);
}
