// SPDX-License-Identifier: Apache-2.0
// Algebra that changes no bit of any result, for any input, NaN and Inf included; only the sign of a zero may change,
// which the language does not promise. The ones that use that liberty: x + 0, x - 0, smul(g, constant) -> g * constant,
// smul(0, x) -> 0, the sum of a single element. Left out on purpose: x * 0, x - x, x / x, reassociation, division by a
// constant as multiplication: they change results.
// Rules look at definitions through Emitter::definition, which hides those of Grad targets: y = neg(neg(t)) may become
// t, but where t = neg(u) is a target, neg(t) may not become u.
#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "compiler/ops/op.h"
#include "compiler/passes/simplify/simplify.h"

namespace dr::passes {

using namespace ir;

namespace {

class Identities {
 public:
  Identities(Emitter& emitter, const Candidate& candidate) : e_(emitter), c_(candidate) {}

  std::optional<ValueId> apply() {
    if (auto simpler = unstretched()) return simpler;
    static const std::map<OpKind, std::optional<ValueId> (Identities::*)()> kRules = {
        {OpKind::Add, &Identities::add},
        {OpKind::Sub, &Identities::sub},
        {OpKind::Mul, &Identities::mul},
        {OpKind::SMul, &Identities::smul},
        {OpKind::Div, &Identities::div},
        {OpKind::Neg, &Identities::involution},
        {OpKind::BitNot, &Identities::involution},
        {OpKind::LogicalNot, &Identities::involution},
        {OpKind::LogicalAnd, &Identities::logical_and},
        {OpKind::LogicalOr, &Identities::logical_or},
        {OpKind::Select, &Identities::select},
        {OpKind::Convert, &Identities::convert},
        {OpKind::Extract, &Identities::extract},
        {OpKind::Compose, &Identities::compose},
        {OpKind::Coord, &Identities::coord},
        {OpKind::Broadcast, &Identities::broadcast_again},
        {OpKind::Gather, &Identities::gather},
        {OpKind::Shift, &Identities::shift},
        {OpKind::Length, &Identities::length},
        {OpKind::ReduceSum, &Identities::reduce},
        {OpKind::ReduceMin, &Identities::reduce},
        {OpKind::ReduceMax, &Identities::reduce},
    };
    const auto rule = kRules.find(c_.kind);
    return rule == kRules.end() ? std::nullopt : (this->*rule->second)();
  }

 private:
  ValueId operand(size_t k) const { return c_.operands[k]; }

  // A value in place of the result: it must have the result's type and stretch to its extent.
  std::optional<ValueId> in_place(ValueId id) {
    if (e_.value(id).type != c_.type) return std::nullopt;
    return e_.stretched(id, c_.extent);
  }
  std::optional<ValueId> same(size_t k) { return in_place(operand(k)); }

  std::optional<ValueId> constant(double component) {
    const ValueId id =
        e_.make_constant(c_.type, std::vector<double>(static_cast<size_t>(c_.type.components()), component));
    return e_.stretched(id, c_.extent);
  }

  bool is_all(size_t k, double component) const {
    const auto* constant = e_.constant_everywhere(operand(k));
    return constant && std::all_of(constant->begin(), constant->end(), [&](double x) { return x == component; });
  }

  // Another op with the result's type and extent.
  std::optional<ValueId> instead(OpKind kind, std::vector<ValueId> operands, Attrs attrs = {}) {
    return e_.emit({kind, std::move(operands), std::move(attrs), c_.type, c_.extent, c_.span});
  }

  // Element-wise ops stretch their operands by themselves: op(broadcast(a), b) -> op(a, b) where b has the extent.
  std::optional<ValueId> unstretched() {
    if (ops::info(c_.kind).shape != ops::Shape::Elementwise || c_.operands.size() < 2) return std::nullopt;
    std::vector<ValueId> operands = c_.operands;
    bool found = false;
    for (size_t k = 0; k < operands.size(); ++k) {
      const Op* stretch = e_.definition(operands[k], OpKind::Broadcast);
      if (!stretch) continue;
      const ValueId stretched_operand = std::exchange(operands[k], stretch->operands[0]);
      std::optional<Extent> common = Extent{};
      for (ValueId id : operands) {
        if (common) common = broadcast(*common, e_.value(id).extent);
      }
      if (common && *common == c_.extent) {
        found = true;
      } else {
        operands[k] = stretched_operand;
      }
    }
    if (!found) return std::nullopt;
    return instead(c_.kind, std::move(operands), c_.attrs);
  }

  // A term that is zero whatever the data.
  bool is_zero(size_t k) const { return e_.leaves_out(&Skips::zero) && is_all(k, 0); }
  std::optional<ValueId> without(std::optional<ValueId> rest) {
    if (rest) e_.count(&Skips::LeftOut::zero);
    return rest;
  }

  std::optional<ValueId> add() {
    if (is_zero(1)) return without(same(0));
    if (is_zero(0)) return without(same(1));
    if (const Op* negation = e_.definition(operand(1), OpKind::Neg))
      return instead(OpKind::Sub, {operand(0), negation->operands[0]});
    if (const Op* negation = e_.definition(operand(0), OpKind::Neg))
      return instead(OpKind::Sub, {operand(1), negation->operands[0]});
    return std::nullopt;
  }

  std::optional<ValueId> sub() {
    if (is_zero(1)) return without(same(0));
    if (const Op* negation = e_.definition(operand(1), OpKind::Neg))
      return instead(OpKind::Add, {operand(0), negation->operands[0]});
    return std::nullopt;
  }

  std::optional<ValueId> div() { return is_all(1, 1) ? same(0) : std::nullopt; }
  std::optional<ValueId> convert() { return same(0); }
  std::optional<ValueId> logical_and() { return logical(1, 0); }
  std::optional<ValueId> logical_or() { return logical(0, 1); }

  std::optional<ValueId> mul() {
    for (size_t k : {0u, 1u}) {
      if (is_all(k, 1)) return same(1 - k);
      if (is_all(k, -1) && e_.value(operand(1 - k)).type == c_.type) {
        const ValueId x = operand(1 - k);
        return in_place(e_.emit({OpKind::Neg, {x}, {}, c_.type, e_.value(x).extent, c_.span}));
      }
      if (is_all(k, 0) && c_.type.is_integer()) return constant(0);
    }
    return std::nullopt;
  }

  std::optional<ValueId> smul() {
    if (is_zero(0)) return without(constant(0));
    if (e_.value(operand(0)).type != c_.type || e_.value(operand(1)).type != c_.type) return std::nullopt;
    const auto* g = e_.constant_everywhere(operand(0));
    const auto* x = e_.constant_everywhere(operand(1));
    const bool never_zero = g && std::none_of(g->begin(), g->end(), [](double component) { return component == 0; });
    // 0 * x is zero where x is finite, in float32.
    const bool finite = x && std::all_of(x->begin(), x->end(),
                                         [](double component) { return std::isfinite(static_cast<float>(component)); });
    if (never_zero || finite) return instead(OpKind::Mul, c_.operands);
    return std::nullopt;
  }

  std::optional<ValueId> involution() {
    const Op* inner = e_.definition(operand(0), c_.kind);
    return inner ? in_place(inner->operands[0]) : std::nullopt;
  }

  // One constant leaves the other operand as it is, the other decides alone.
  std::optional<ValueId> logical(double neutral, double deciding) {
    for (size_t k : {0u, 1u}) {
      if (is_all(k, neutral)) return same(1 - k);
      if (is_all(k, deciding)) return constant(deciding);
    }
    return std::nullopt;
  }

  std::optional<ValueId> select() {
    if (is_all(0, 1) || operand(1) == operand(2)) return same(1);
    if (is_all(0, 0)) return same(2);
    return std::nullopt;
  }

  std::optional<ValueId> extract() {
    if (const Op* splat = e_.definition(operand(0), OpKind::Splat)) return in_place(splat->operands[0]);
    if (const Op* whole = e_.definition(operand(0), OpKind::Compose)) {
      const auto index = static_cast<size_t>(c_.attrs.ints[0]);
      if (index < whole->operands.size()) return in_place(whole->operands[index]);
    }
    return extract_of_select();
  }

  // select(c, u, v).x -> select(c, u.x, v.x), of integers that are there: which vertex of two a corner of a face is,
  // say. They may be one.
  std::optional<ValueId> extract_of_select() {
    const Op* found = e_.definition(operand(0), OpKind::Select);
    if (!found || c_.type.is_float() || e_.value(found->operands[0]).type != kBool) return std::nullopt;
    std::vector<ValueId> operands = found->operands;
    for (size_t k = 1; k < operands.size(); ++k) {
      const Op* whole = e_.definition(operands[k], OpKind::Compose);
      const auto index = static_cast<size_t>(c_.attrs.ints[0]);
      const auto part =
          whole && index < whole->operands.size()
              ? std::optional(whole->operands[index])
              : e_.existing({OpKind::Extract, {operands[k]}, c_.attrs, c_.type, e_.value(operands[k]).extent, c_.span});
      if (!part || e_.value(*part).type != c_.type) return std::nullopt;
      operands[k] = *part;
    }
    return instead(OpKind::Select, std::move(operands));
  }

  // x.at(select(c, i, j)) -> select(c, x.at(i), x.at(j)), where both are read anyway. A gradient is taken of the one
  // read as it is written.
  std::optional<ValueId> gather_of_select() {
    const Op* found = e_.definition(operand(1), OpKind::Select);
    if (!found || !e_.differentiated() || c_.type.is_matrix() || e_.value(found->operands[0]).type != kBool)
      return std::nullopt;
    std::vector<ValueId> operands = found->operands;
    for (size_t k = 1; k < operands.size(); ++k) {
      const auto read = e_.existing({c_.kind, {operand(0), operands[k]}, c_.attrs, c_.type, c_.extent, c_.span});
      if (!read) return std::nullopt;
      operands[k] = *read;
    }
    return instead(OpKind::Select, std::move(operands));
  }

  // Along an axis of one element.
  std::optional<ValueId> coord() {
    return c_.attrs.dims[static_cast<size_t>(c_.attrs.ints[0])].is_one() ? constant(0) : std::nullopt;
  }

  // compose(v.x, v.y, v.z) -> v
  std::optional<ValueId> compose() {
    std::optional<ValueId> whole;
    for (size_t k = 0; k < c_.operands.size(); ++k) {
      const Op* part = e_.definition(operand(k), OpKind::Extract);
      if (!part || part->attrs.ints[0] != static_cast<int64_t>(k) || (whole && *whole != part->operands[0]))
        return std::nullopt;
      whole = part->operands[0];
    }
    return whole ? in_place(*whole) : std::nullopt;
  }

  std::optional<ValueId> broadcast_again() {
    if (e_.value(operand(0)).extent == c_.extent) return operand(0);
    if (const Op* inner = e_.definition(operand(0), OpKind::Broadcast))
      return instead(OpKind::Broadcast, inner->operands, c_.attrs);
    return std::nullopt;
  }

  // Of other constants, devices compute it.
  std::optional<ValueId> length() { return is_all(0, 0) ? constant(0) : std::nullopt; }

  std::optional<ValueId> shift() {
    const bool still = std::all_of(c_.attrs.ints.begin(), c_.attrs.ints.end(), [](int64_t by) { return by == 0; });
    return still ? same(0) : std::nullopt;
  }

  std::optional<ValueId> gather() {
    if (auto simpler = gather_of_select()) return simpler;
    if (e_.in_root() && e_.value(operand(0)).extent.is_unit() && is_all(1, 0)) return same(0);  // all there is
    return own_place();
  }

  // What an element reads at its own place is itself.
  std::optional<ValueId> own_place() {
    if (!e_.in_root() || e_.value(operand(0)).extent != c_.extent) return pull_gather(e_, c_);
    std::vector<ValueId> axes{operand(1)};
    if (const Op* place = e_.definition(operand(1), OpKind::Compose)) axes = place->operands;
    for (size_t axis = 0; axis < axes.size(); ++axis) {
      const Op* coordinate = e_.definition(axes[axis], OpKind::Coord);
      if (!coordinate || coordinate->attrs.ints[0] != static_cast<int64_t>(axis)) return pull_gather(e_, c_);
    }
    return same(0);
  }

  // Axes of extent 1 have nothing to reduce.
  std::optional<ValueId> reduce() {
    const Extent& extent = e_.value(operand(0)).extent;
    Attrs attrs = c_.attrs;
    const Dim* axes[] = {&extent.w, &extent.h, &extent.l};
    for (size_t axis = 0; axis < 3; ++axis) {
      if (axes[axis]->is_one()) attrs.ints[axis] = 0;
    }
    if (std::count(attrs.ints.begin(), attrs.ints.end(), 0) == 3) return same(0);
    if (attrs.ints == c_.attrs.ints) return std::nullopt;
    return instead(c_.kind, c_.operands, std::move(attrs));
  }

  Emitter& e_;
  const Candidate& c_;
};

}  // namespace

std::optional<ValueId> apply_identity(Emitter& emitter, const Candidate& candidate) {
  return Identities(emitter, candidate).apply();
}

}  // namespace dr::passes
