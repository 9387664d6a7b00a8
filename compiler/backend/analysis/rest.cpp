// SPDX-License-Identifier: Apache-2.0
// Ranges of numbers, wide enough for how devices round. A range holds no NaN and no infinity; what may be one has none.
#include "compiler/backend/analysis/rest.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "compiler/ops/op.h"

namespace dr::backend {

using ir::Graph;
using ir::Op;
using ir::OpId;
using ir::OpKind;
using ir::ValueId;

namespace {

struct Range {
  double low = 0, high = 0;
  bool is_zero() const { return low == 0 && high == 0; }
  bool is(double x) const { return low == x && high == x; }
};
using MaybeRange = std::optional<Range>;

// What lies between 0 and the one may be flushed to 0, and what is beyond the other may overflow.
constexpr double kLeast = 2e-38, kMost = 1e38;
constexpr double kMargin = 1e-3;
constexpr double kInts = 2147483647.0;

MaybeRange rounded(double low, double high, bool is_float) {
  if (std::isnan(low) || std::isnan(high)) return std::nullopt;
  if (!is_float) return low < -kInts || high > kInts ? std::nullopt : MaybeRange({low, high});
  low -= kMargin * std::abs(low);
  high += kMargin * std::abs(high);
  if (low > 0 && low < kLeast) low = 0;
  if (high < 0 && high > -kLeast) high = 0;
  return low < -kMost || high > kMost ? std::nullopt : MaybeRange({low, high});
}

MaybeRange hull(const MaybeRange& a, const MaybeRange& b) {
  if (!a || !b) return std::nullopt;
  return Range{std::min(a->low, b->low), std::max(a->high, b->high)};
}

MaybeRange truth(bool known, bool value) {
  return known ? MaybeRange({value ? 1.0 : 0.0, value ? 1.0 : 0.0}) : MaybeRange({0.0, 1.0});
}

MaybeRange product(const Range& a, const Range& b, bool is_float) {
  if (a.is_zero() || b.is_zero()) return Range{};
  const auto [low, high] = std::minmax({a.low * b.low, a.low * b.high, a.high * b.low, a.high * b.high});
  return rounded(low, high, is_float);
}

MaybeRange quotient(const Range& a, const Range& b) {
  if (b.low <= 0 && b.high >= 0) return std::nullopt;
  if (a.is_zero()) return Range{};
  const auto [low, high] = std::minmax({a.low / b.low, a.low / b.high, a.high / b.low, a.high / b.high});
  return rounded(low, high, true);
}

// Of functions that rise, and are defined from `from` on.
MaybeRange rising(const Range& a, double from, double (*f)(double)) {
  if (a.low < from) return std::nullopt;
  const double low = f(a.low), high = f(a.high);
  return a.is_zero() && low == 0 ? MaybeRange(Range{}) : rounded(low, high, true);
}

MaybeRange magnitude(const Range& a) {
  const double most = std::max(std::abs(a.low), std::abs(a.high));
  return Range{a.low <= 0 && a.high >= 0 ? 0 : std::min(std::abs(a.low), std::abs(a.high)), most};
}

MaybeRange compared(OpKind kind, const Range& a, const Range& b) {
  const bool below = a.high<b.low, above = a.low> b.high, same = a.is_zero() && b.is_zero();
  switch (kind) {
    case OpKind::Less: return truth(below || above || same, below);
    case OpKind::LessEqual: return truth(below || above || same, below || same);
    case OpKind::Equal: return truth(below || above || same, same);
    default: return truth(below || above || same, !same);
  }
}

// `of`: the operands' ranges, all known.
MaybeRange range_of_known(const Graph& graph, const Op& op, std::span<const Range> of) {
  const bool is_float = graph.value(op.results[0]).type.is_float();
  switch (op.kind) {
    case OpKind::Add:
      if (of[0].is_zero() && of[1].is_zero()) return Range{};
      return rounded(of[0].low + of[1].low, of[0].high + of[1].high, is_float);
    case OpKind::Sub:
      if (of[0].is_zero() && of[1].is_zero()) return Range{};
      return rounded(of[0].low - of[1].high, of[0].high - of[1].low, is_float);
    case OpKind::Mul:
    case OpKind::SMul: return product(of[0], of[1], is_float);
    case OpKind::Div: return is_float ? quotient(of[0], of[1]) : std::nullopt;
    case OpKind::Neg: return Range{-of[0].high, -of[0].low};
    case OpKind::Abs: return magnitude(of[0]);
    case OpKind::Min: return Range{std::min(of[0].low, of[1].low), std::min(of[0].high, of[1].high)};
    case OpKind::Max: return Range{std::max(of[0].low, of[1].low), std::max(of[0].high, of[1].high)};
    case OpKind::Sqrt: return rising(of[0], 0, [](double x) { return std::sqrt(x); });
    case OpKind::Exp: return rising(of[0], -kMost, [](double x) { return std::exp(x); });
    case OpKind::Expm1: return rising(of[0], -kMost, [](double x) { return std::expm1(x); });
    case OpKind::Log: return rising(of[0], kLeast, [](double x) { return std::log(x); });
    case OpKind::Less:
    case OpKind::LessEqual:
    case OpKind::Equal:
    case OpKind::NotEqual: return compared(op.kind, of[0], of[1]);
    case OpKind::LogicalAnd: return Range{std::min(of[0].low, of[1].low), std::min(of[0].high, of[1].high)};
    case OpKind::LogicalOr: return Range{std::max(of[0].low, of[1].low), std::max(of[0].high, of[1].high)};
    case OpKind::LogicalNot: return Range{1 - of[0].high, 1 - of[0].low};
    case OpKind::Select: return hull(of[1], of[2]);
    case OpKind::Convert:
      return is_float && !graph.value(op.operands[0]).type.is_float() ? rounded(of[0].low, of[0].high, true)
                                                                      : std::nullopt;
    case OpKind::Length: {
      const double most = magnitude(of[0])->high;
      return of[0].is_zero() ? MaybeRange(Range{}) : rounded(0, 2 * most, true);
    }
    case OpKind::Dot: return of[0].is_zero() || of[1].is_zero() ? MaybeRange(Range{}) : std::nullopt;
    default: return std::nullopt;
  }
}

class Facts {
 public:
  Facts(const Graph& graph, RestFacts known) : graph_(graph), out_(std::move(known)) {
    for (const ValueId v : out_.zero) {
      ranges_[v] = Range{};
      out_.fixed.insert(v);
    }
  }

  RestFacts process(std::span<const OpId> ops) && {
    for (const OpId id : ops) visit(graph_.op(id));
    return std::move(out_);
  }

 private:
  MaybeRange range(ValueId v) const {
    if (const auto known = ranges_.find(v); known != ranges_.end()) return known->second;
    const bool counts = graph_.op(graph_.value(v).op).kind == OpKind::StepIndex;  // a step has fewer runs than kInts
    return counts ? MaybeRange({0, kInts - 1}) : std::nullopt;
  }

  MaybeRange find_range(const Op& op) const {
    if (op.kind == OpKind::Const) {
      const auto [low, high] = std::ranges::minmax(op.attrs.floats);
      if (low == 0 && high == 0) return Range{};
      return rounded(low, high, graph_.value(op.results[0]).type.is_float());
    }
    if (op.kind == OpKind::DimValue) return Range{0, kInts};
    if (op.operands.empty()) return std::nullopt;
    if (op.kind == OpKind::Broadcast) return range(op.operands[0]);
    if (op.kind == OpKind::SMul && is_zero(op.operands[0])) return Range{};
    if (ops::info(op.kind).moves) {
      MaybeRange all = range(op.operands[0]);
      for (const ValueId v : op.operands) all = hull(all, range(v));
      return all;
    }
    std::vector<Range> of;
    for (const ValueId v : op.operands) {
      const MaybeRange one = range(v);
      if (!one) return std::nullopt;
      of.push_back(*one);
    }
    return range_of_known(graph_, op, of);
  }

  bool is_zero(ValueId v) const { return out_.zero.count(v) != 0; }

  void visit(const Op& op) {
    if (op.results.size() != 1 || !op.regions.empty()) return;
    const ValueId result = op.results[0];
    if (is_zero(result)) return;
    if (op.kind == OpKind::Select)
      if (const MaybeRange condition = range(op.operands[0]); condition && (condition->is(0) || condition->is(1))) {
        const ValueId chosen = op.operands[condition->is(1) ? 1 : 2];
        if (const MaybeRange known = range(chosen)) ranges_[result] = *known;
        if (is_zero(chosen)) out_.zero.insert(result);
        if (out_.fixed.count(chosen) == 0) return;
        out_.fixed.insert(result);
        out_.chosen[result] = chosen;
        return;
      }
    if (const MaybeRange known = find_range(op)) {
      ranges_[result] = *known;
      if (known->is_zero()) out_.zero.insert(result), out_.fixed.insert(result);
    }
    const bool from_here = ops::info(op.kind).shape == ops::Shape::Elementwise || op.kind == OpKind::Const ||
                           op.kind == OpKind::DimValue || op.kind == OpKind::Broadcast;
    if (from_here && std::ranges::all_of(op.operands, [&](ValueId v) { return out_.fixed.count(v) != 0; }))
      out_.fixed.insert(result);
  }

  const Graph& graph_;
  RestFacts out_;
  std::map<ValueId, Range> ranges_;
};

}  // namespace

RestFacts facts_at_rest(const Graph& graph, RestFacts known) {
  return Facts(graph, std::move(known)).process(graph.region(graph.root()).ops);
}

}  // namespace dr::backend
