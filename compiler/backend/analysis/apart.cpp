// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/analysis/apart.h"

#include <algorithm>
#include <map>
#include <vector>

#include "compiler/ir/dim_bound.h"

namespace dr::backend {

using ir::Dim;
using ir::Graph;
using ir::Op;
using ir::OpKind;
using ir::ValueId;

namespace {

// More selects, lines or values say nothing.
constexpr int kMostSelects = 4;
constexpr size_t kMostLines = 16;
constexpr int kMostDepth = 24, kMostValues = 2000;
constexpr int64_t kMostDivisor = 1 << 20;  // of lines

// (base + plus) / by, not rounded; without a base plus / by.
struct Line {
  ValueId base;
  int64_t by = 1;
  Dim plus = 0;
};
using Lines = std::vector<Line>;

// What holds on one side of some selects.
struct Believed {
  std::map<ValueId, size_t> taken;  // operand of the select
  std::map<ValueId, Dim> least, most;
};

class Apart {
 public:
  explicit Apart(const Graph& graph) : graph_(graph) {}

  std::optional<int64_t> most(ValueId high, ValueId low, const Believed& believed, int selects) const {
    high = plain(high, believed), low = plain(low, believed);
    if (high == low) return 0;
    left_ = kMostValues;
    ValueId select = open_select(high, believed, kMostDepth);
    if (!select.valid()) select = open_select(low, believed, kMostDepth);
    left_ = kMostValues;
    if (!select.valid()) return by_lines(high, low, believed);
    if (selects == 0) return std::nullopt;
    const Op& op = op_of(select);
    std::optional<int64_t> out;
    for (const bool holds : {true, false}) {
      Believed more = believed;
      left_ = kMostValues;
      more.taken[select] = holds ? 1 : 2;
      learn(op.operands[0], holds, more);
      const auto one = most(high, low, more, selects - 1);
      if (!one) return std::nullopt;
      out = std::max(out.value_or(*one), *one);
    }
    return out;
  }

 private:
  const Op& op_of(ValueId v) const { return graph_.op(graph_.value(v).op); }
  bool is(ValueId v, OpKind kind) const { return graph_.value(v).op.valid() && op_of(v).kind == kind; }

  // Without what only names it anew, and on the side that is taken.
  ValueId plain(ValueId v, const Believed& believed) const {
    while (graph_.value(v).op.valid()) {
      const Op& op = op_of(v);
      if (op.kind == OpKind::Broadcast || op.kind == OpKind::Detach || op.kind == OpKind::Pin) {
        v = op.operands[0];
      } else if (op.kind == OpKind::Extract && is(op.operands[0], OpKind::Compose)) {
        v = op_of(op.operands[0]).operands[static_cast<size_t>(op.attrs.ints[0])];
      } else if (const auto taken = believed.taken.find(v); taken != believed.taken.end()) {
        v = op.operands[taken->second];
      } else {
        break;
      }
    }
    return v;
  }

  static bool is_looked_through(OpKind kind) {
    return kind == OpKind::Add || kind == OpKind::Sub || kind == OpKind::Min || kind == OpKind::Max ||
           kind == OpKind::Div || kind == OpKind::Mod;
  }

  // A select that decides about the value, whose side is not chosen yet.
  ValueId open_select(ValueId v, const Believed& believed, int depth) const {
    v = plain(v, believed);
    if (depth == 0 || --left_ < 0 || !graph_.value(v).op.valid()) return {};
    const Op& op = op_of(v);
    if (op.kind == OpKind::Select) return v;
    if (!is_looked_through(op.kind)) return {};
    for (const ValueId operand : op.operands)
      if (const ValueId found = open_select(operand, believed, depth - 1); found.valid()) return found;
    return {};
  }

  // Of a comparison with an extent or a number.
  void learn(ValueId condition, bool holds, Believed& believed) const {
    condition = plain(condition, believed);
    if (--left_ < 0 || !graph_.value(condition).op.valid()) return;
    const Op& op = op_of(condition);
    if (op.kind == OpKind::LogicalAnd && holds) {
      for (const ValueId part : op.operands) learn(part, true, believed);
    } else if (op.kind == OpKind::LogicalNot) {
      learn(op.operands[0], !holds, believed);
    } else if (op.kind == OpKind::LessEqual || op.kind == OpKind::Less) {
      // a <= b, or where that does not hold b <= a - 1.
      const bool less = op.kind == OpKind::Less;
      if (holds)
        learn_order(op.operands[0], op.operands[1], less ? 1 : 0, believed);
      else
        learn_order(op.operands[1], op.operands[0], less ? 0 : 1, believed);
    }
  }

  // a + by <= b.
  void learn_order(ValueId a, ValueId b, int64_t by, Believed& believed) const {
    a = plain(a, believed), b = plain(b, believed);
    if (graph_.value(a).type.scalar != ir::Scalar::Int) return;
    if (const auto least = number(a)) believed.least.try_emplace(b, *least + Dim(by));
    if (const auto most = number(b)) believed.most.try_emplace(a, *most - Dim(by));
  }

  // Of extents and numbers:  W    W - 1
  std::optional<Dim> number(ValueId v, int depth = 4) const {
    if (!graph_.value(v).op.valid()) return std::nullopt;
    const Op& op = op_of(v);
    if (op.kind == OpKind::DimValue) return op.attrs.dims[0];
    if ((op.kind == OpKind::Add || op.kind == OpKind::Sub) && depth > 0) {
      const auto a = number(plain(op.operands[0], {}), depth - 1), b = number(plain(op.operands[1], {}), depth - 1);
      if (!a || !b) return std::nullopt;
      return op.kind == OpKind::Add ? *a + *b : *a - *b;
    }
    if (op.kind != OpKind::Const || graph_.value(v).type.scalar != ir::Scalar::Int ||
        std::ranges::any_of(op.attrs.floats, [&](double x) { return x != op.attrs.floats[0]; }))
      return std::nullopt;
    return Dim(static_cast<int64_t>(op.attrs.floats[0]));
  }
  int64_t positive(ValueId v, const Believed& believed) const {
    const auto n = number(plain(v, believed));
    return n && n->is_constant() && n->constant() > 0 && n->constant() < 1 << 16 ? n->constant() : 0;
  }

  // Lines none of which the value is above, or below.
  Lines lines(ValueId v, bool above, const Believed& believed, int depth) const {
    v = plain(v, believed);
    if (const auto n = number(v)) return {{{}, 1, *n}};
    Lines itself{{v, 1, Dim(0)}};
    if (depth == 0 || --left_ < 0 || !graph_.value(v).op.valid() || graph_.value(v).type.scalar != ir::Scalar::Int)
      return itself;
    const Op& op = op_of(v);
    const auto of = [&](size_t k, bool side) { return lines(op.operands[k], side, believed, depth - 1); };
    Lines out;
    if (op.kind == OpKind::Min || op.kind == OpKind::Max) {
      // Below a minimum is what is below both.
      if ((op.kind == OpKind::Min) != above) return itself;
      out = of(0, above);
      for (const Line& line : of(1, above)) out.push_back(line);
    } else if (op.kind == OpKind::Add) {
      const Lines a = of(0, above), b = of(1, above);
      out = sums(a, b, 1);
      if (out.empty()) out = sums(b, a, 1);
    } else if (op.kind == OpKind::Sub) {
      if (const int64_t by = divisor_of(v, believed)) return moved(of(0, above), above ? 0 : 1 - by);
      out = sums(of(0, above), of(1, !above), -1);
    } else if (op.kind == OpKind::Mod) {
      if (const int64_t by = positive(op.operands[1], believed)) return {{{}, 1, Dim(above ? by - 1 : 0)}};
    } else if (op.kind == OpKind::Div) {
      if (const int64_t by = positive(op.operands[1], believed)) {
        // Of a multiple it is not rounded; else towards 0.
        const bool even = divisor_of(op.operands[0], believed) == by;
        out = moved(of(0, above), even ? 0 : above ? by - 1 : 1 - by);
        for (Line& line : out) {
          line.by *= by;
          if (line.by > kMostDivisor) return itself;
        }
      }
    }
    return out.empty() || out.size() > kMostLines ? itself : out;
  }

  // The number that it is a multiple of, as x - x mod by is of `by`; else 0.
  int64_t divisor_of(ValueId v, const Believed& believed) const {
    v = plain(v, believed);
    if (!is(v, OpKind::Sub)) return 0;
    const ValueId whole = plain(op_of(v).operands[0], believed), rest = plain(op_of(v).operands[1], believed);
    const bool is_rest = is(rest, OpKind::Mod) && plain(op_of(rest).operands[0], believed) == whole;
    return is_rest ? positive(op_of(rest).operands[1], believed) : 0;
  }

  static Lines moved(Lines lines, int64_t plus) {
    for (Line& line : lines) line.plus = line.plus + Dim(plus * line.by);
    return lines;
  }

  // Those of the second kind that are whole numbers, added or taken away.
  static Lines sums(const Lines& some, const Lines& numbers, int64_t sign) {
    Lines out;
    for (const Line& line : some)
      for (const Line& number : numbers)
        if (!number.base.valid() && number.by == 1)
          out.push_back({line.base, line.by, line.plus + Dim(sign * line.by) * number.plus});
    return out;
  }

  std::optional<Dim> bound(ValueId base, bool above, const Believed& believed) const {
    if (!base.valid()) return Dim(0);
    const auto& bounds = above ? believed.most : believed.least;
    if (const auto it = bounds.find(base); it != bounds.end()) return it->second;
    if (!is(base, OpKind::Coord)) return std::nullopt;
    const Op& op = op_of(base);
    return above ? op.attrs.dims[static_cast<size_t>(op.attrs.ints[0])] - Dim(1) : Dim(0);
  }

  std::optional<int64_t> by_lines(ValueId high, ValueId low, const Believed& believed) const {
    std::optional<int64_t> best;
    const auto take = [&](const Dim& dividend, int64_t by) {
      if (const auto one = ir::most_of_quotient(dividend, by)) best = std::min(best.value_or(*one), *one);
    };
    const Lines below = lines(low, false, believed, kMostDepth);
    for (const Line& h : lines(high, true, believed, kMostDepth))
      for (const Line& l : below) {
        if (h.base == l.base && h.by == l.by) take(h.plus - l.plus, h.by);
        const auto most = bound(h.base, true, believed), least = bound(l.base, false, believed);
        if (most && least) take(Dim(l.by) * (*most + h.plus) - Dim(h.by) * (*least + l.plus), h.by * l.by);
      }
    return best;
  }

  const Graph& graph_;
  mutable int left_ = 0;  // values that are looked at, for selects, conditions or lines
};

}  // namespace

std::optional<int64_t> most_apart(const Graph& graph, ValueId high, ValueId low) {
  return Apart(graph).most(high, low, {}, kMostSelects);
}

}  // namespace dr::backend
