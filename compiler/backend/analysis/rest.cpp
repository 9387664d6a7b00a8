// SPDX-License-Identifier: Apache-2.0
// Ranges of numbers, wide enough for how devices round. A range holds no NaN and no infinity; what may be one has none.
#include "compiler/backend/analysis/rest.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

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

MaybeRange lesser(const Range& a, const Range& b) { return Range{std::min(a.low, b.low), std::min(a.high, b.high)}; }
MaybeRange greater(const Range& a, const Range& b) { return Range{std::max(a.low, b.low), std::max(a.high, b.high)}; }

MaybeRange magnitude(const Range& a) {
  const double most = std::max(std::abs(a.low), std::abs(a.high));
  return Range{a.low <= 0 && a.high >= 0 ? 0 : std::min(std::abs(a.low), std::abs(a.high)), most};
}

// Of a comparison: whether it is known, and what it says.
struct Compared {
  bool below, above, same;
  Compared(const Range& a, const Range& b)
      : below(a.high < b.low), above(a.low > b.high), same(a.is_zero() && b.is_zero()) {}
  MaybeRange is(bool value) const { return truth(below || above || same, value); }
};

MaybeRange converted(const Graph& graph, const Op& op, const Range& of) {
  const bool to_float = graph.value(op.results[0]).type.is_float() && !graph.value(op.operands[0]).type.is_float();
  return to_float ? rounded(of.low, of.high, true) : std::nullopt;
}

// What an op's range is where those of its operands are known.
struct Known {
  const Graph& graph;
  const Op& op;
  std::span<const Range> of;
  bool is_float;

  bool all_zero() const {
    return std::ranges::all_of(of, [](const Range& r) { return r.is_zero(); });
  }
};
using Rule = MaybeRange (*)(const Known&);

const std::map<OpKind, Rule>& rules() {
  static const std::map<OpKind, Rule> kRules = {
      {OpKind::Add,
       [](const Known& k) {
         return k.all_zero() ? Range{} : rounded(k.of[0].low + k.of[1].low, k.of[0].high + k.of[1].high, k.is_float);
       }},
      {OpKind::Sub,
       [](const Known& k) {
         return k.all_zero() ? Range{} : rounded(k.of[0].low - k.of[1].high, k.of[0].high - k.of[1].low, k.is_float);
       }},
      {OpKind::Mul, [](const Known& k) { return product(k.of[0], k.of[1], k.is_float); }},
      {OpKind::SMul, [](const Known& k) { return product(k.of[0], k.of[1], k.is_float); }},
      {OpKind::Div, [](const Known& k) { return k.is_float ? quotient(k.of[0], k.of[1]) : std::nullopt; }},
      {OpKind::Neg,
       [](const Known& k) {
         return MaybeRange({-k.of[0].high, -k.of[0].low});
       }},
      {OpKind::Abs, [](const Known& k) { return magnitude(k.of[0]); }},
      {OpKind::Min, [](const Known& k) { return lesser(k.of[0], k.of[1]); }},
      {OpKind::Max, [](const Known& k) { return greater(k.of[0], k.of[1]); }},
      {OpKind::Sqrt, [](const Known& k) { return rising(k.of[0], 0, [](double x) { return std::sqrt(x); }); }},
      {OpKind::Exp, [](const Known& k) { return rising(k.of[0], -kMost, [](double x) { return std::exp(x); }); }},
      {OpKind::Expm1, [](const Known& k) { return rising(k.of[0], -kMost, [](double x) { return std::expm1(x); }); }},
      {OpKind::Log, [](const Known& k) { return rising(k.of[0], kLeast, [](double x) { return std::log(x); }); }},
      {OpKind::Less, [](const Known& k) { return Compared(k.of[0], k.of[1]).is(k.of[0].high < k.of[1].low); }},
      {OpKind::LessEqual, [](const Known& k) { return Compared(k.of[0], k.of[1]).is(k.of[0].high <= k.of[1].low); }},
      {OpKind::Equal, [](const Known& k) { return Compared(k.of[0], k.of[1]).is(k.all_zero()); }},
      {OpKind::NotEqual, [](const Known& k) { return Compared(k.of[0], k.of[1]).is(!k.all_zero()); }},
      {OpKind::LogicalAnd, [](const Known& k) { return lesser(k.of[0], k.of[1]); }},
      {OpKind::LogicalOr, [](const Known& k) { return greater(k.of[0], k.of[1]); }},
      {OpKind::LogicalNot,
       [](const Known& k) {
         return MaybeRange({1 - k.of[0].high, 1 - k.of[0].low});
       }},
      {OpKind::Convert, [](const Known& k) { return converted(k.graph, k.op, k.of[0]); }},
      {OpKind::Length,
       [](const Known& k) { return k.all_zero() ? Range{} : rounded(0, 2 * magnitude(k.of[0])->high, true); }},
      {OpKind::Dot,
       [](const Known& k) { return k.of[0].is_zero() || k.of[1].is_zero() ? MaybeRange(Range{}) : std::nullopt; }},
  };
  return kRules;
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
    if (op.kind == OpKind::Select) return hull(range(op.operands[1]), range(op.operands[2]));
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
    const auto rule = rules().find(op.kind);
    if (rule == rules().end()) return std::nullopt;
    return rule->second({graph_, op, of, graph_.value(op.results[0]).type.is_float()});
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
