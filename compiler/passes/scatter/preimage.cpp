// SPDX-License-Identifier: Apache-2.0
#include "compiler/passes/scatter/preimage.h"

#include <algorithm>
#include <utility>

#include "compiler/ops/emit.h"

namespace dr::passes {

using namespace ir;

namespace {

// Beyond every place, and far enough from the ends of int to move from there.
constexpr int64_t kBeyond = int64_t{1} << 30;

bool hands_on(OpKind kind) {
  return kind == OpKind::Compose || kind == OpKind::Splat || kind == OpKind::Extract || kind == OpKind::Broadcast;
}

std::optional<Dim> dims_sum(const std::optional<Dim>& a, const std::optional<Dim>& b) {
  return a && b ? std::optional(*a + *b) : std::nullopt;
}
std::optional<Dim> dims_difference(const std::optional<Dim>& a, const std::optional<Dim>& b) {
  return a && b ? std::optional(*a - *b) : std::nullopt;
}
std::optional<int64_t> number_of(const std::optional<Dim>& dim) {
  return dim && dim->is_constant() ? std::optional(dim->constant()) : std::nullopt;
}

}  // namespace

const Op* Preimage::maker(ValueId v) const {
  const OpId op = from_.value(v).op;
  return op.valid() ? &from_.op(op) : nullptr;
}

std::optional<int64_t> Preimage::constant(ValueId v, int c) const {
  const Op* op = maker(v);
  while (op && op->kind == OpKind::Broadcast) op = maker(op->operands[0]);
  if (!op || op->kind != OpKind::Const) return std::nullopt;
  return static_cast<int64_t>(op->attrs.floats[static_cast<size_t>(c)]);
}

Preimage::Range Preimage::range(ValueId v, int c) {
  if (const auto x = constant(v, c)) return {Dim(*x), Dim(*x)};
  if (const auto variable = places_.variable(v)) {
    const Trips& trips = variables_[static_cast<size_t>(*variable)];
    return {trips.first, trips.last};
  }
  const Op* op = maker(v);
  if (!op) return {};
  if (op->kind == OpKind::DimValue) return {op->attrs.dims[0], op->attrs.dims[0]};
  const bool known = hands_on(op->kind) || op->kind == OpKind::Add || op->kind == OpKind::Sub ||
                     op->kind == OpKind::Mul || op->kind == OpKind::Neg;
  if (!known || from_.value(v).type.is_matrix()) return {};
  const auto parts = places_.parts(*op, c);
  for (const auto& [operand, part] : parts)
    if (part < 0) return {};
  const Range a = range(parts[0].first, parts[0].second);
  if (hands_on(op->kind)) return a;
  if (op->kind == OpKind::Neg) return {dims_difference(Dim(0), a.most), dims_difference(Dim(0), a.least)};
  const Range b = range(parts[1].first, parts[1].second);
  if (op->kind == OpKind::Add) return {dims_sum(a.least, b.least), dims_sum(a.most, b.most)};
  if (op->kind == OpKind::Sub) return {dims_difference(a.least, b.most), dims_difference(a.most, b.least)};
  for (const bool swapped : {false, true}) {
    const Range &x = swapped ? b : a, &factor = swapped ? a : b;
    const auto k = number_of(factor.least);
    if (!k || factor.least != factor.most || !x.least || !x.most) continue;
    const Dim low = *x.least * Dim(*k), high = *x.most * Dim(*k);
    return *k >= 0 ? Range{low, high} : Range{high, low};
  }
  return {};
}

std::optional<size_t> Preimage::path(const Op& op, int c, Variable variable) {
  std::optional<size_t> out;
  const auto parts = places_.parts(op, c);
  for (size_t k = 0; k < parts.size(); ++k) {
    if ((places_.depends(parts[k].first, parts[k].second) & only(variable)) == 0) continue;
    if (out || parts[k].second < 0) return std::nullopt;
    out = k;
  }
  return out;
}

bool Preimage::exists(ValueId v, int c, Variable variable, Variables& others) {
  return exists(v, c, variable, others, true);
}

bool Preimage::exists(ValueId v, int c, Variable variable, Variables& others, bool single) {
  if (places_.variable(v) == variable) return true;
  const Op* op = maker(v);
  if (!op || op->operands.empty() || !op->regions.empty() || from_.value(v).type.scalar != Scalar::Int) return false;
  const auto k = path(*op, c, variable);
  if (!k) return false;
  const auto parts = places_.parts(*op, c);
  const auto factor = [&]() -> std::optional<int64_t> {
    const auto& [other, part] = parts[1 - *k];
    return part < 0 ? std::nullopt : constant(other, part);
  };
  const OpKind kind = op->kind;
  if (kind == OpKind::Min || kind == OpKind::Max) {
    single = single && !holds(parts[*k], parts[1 - *k], kind == OpKind::Max);
  } else if (kind == OpKind::Clamp) {
    if (*k != 0) return false;
    single = single && !holds(parts[0], parts[1], true) && !holds(parts[0], parts[2], false);
  } else if (kind == OpKind::Mod) {
    if (*k != 0 || !single || !wraps_once(*op, c, variable)) return false;
  } else if (kind == OpKind::Mul) {
    if (const auto f = factor(); !f || *f == 0 || std::abs(*f) > 1 << 16) return false;
  } else if (kind == OpKind::Div) {
    if (const auto f = factor(); *k != 0 || !f || *f <= 0 || *f > 1 << 16) return false;
    single = false;
  } else if (!hands_on(kind) && kind != OpKind::Add && kind != OpKind::Sub && kind != OpKind::Neg &&
             kind != OpKind::Abs) {
    return false;
  }
  for (size_t j = 0; j < parts.size(); ++j)
    if (j != *k) others |= places_.depends(parts[j].first, parts[j].second);
  return exists(parts[*k].first, parts[*k].second, variable, others, single);
}

// Whether it is the variable, or that mirrored, and something added.
bool Preimage::shifts(ValueId v, int c, Variable variable) {
  if (places_.variable(v) == variable) return true;
  const Op* op = maker(v);
  const auto k = op && !op->operands.empty() ? path(*op, c, variable) : std::nullopt;
  if (!k) return false;
  const bool moves = op->kind == OpKind::Add || op->kind == OpKind::Sub || op->kind == OpKind::Neg;
  if (!hands_on(op->kind) && !moves) return false;
  const auto part = places_.parts(*op, c)[*k];
  return shifts(part.first, part.second, variable);
}

// Whether a remainder has each value for one trip at most.
bool Preimage::wraps_once(const Op& op, int c, Variable variable) {
  const auto parts = places_.parts(op, c);
  const Range divisor = range(parts[1].first, parts[1].second);
  const Trips& trips = variables_[static_cast<size_t>(variable)];
  const auto left =
      number_of(dims_difference(dims_difference(divisor.least, Dim(1)), dims_difference(trips.last, trips.first)));
  return divisor.least == divisor.most && left && *left >= 0 && shifts(parts[0].first, parts[0].second, variable);
}

std::vector<Interval> Preimage::of(ValueId v, int c, Variable variable, ValueId q) {
  std::vector<Interval> out;
  Interval whole;
  whole.first = whole.last = q;
  undo(v, c, variable, whole, out);
  return out;
}

void Preimage::undo(ValueId v, int c, Variable variable, const Interval& interval, std::vector<Interval>& out) {
  if (places_.variable(v) == variable) {
    out.push_back(interval);
    return;
  }
  const Op& op = *maker(v);
  const size_t k = *path(op, c, variable);
  const auto parts = places_.parts(op, c);
  const auto on = [&](const Interval& next) { undo(parts[k].first, parts[k].second, variable, next, out); };
  const auto other = [&](size_t j) { return parts[j].first; };
  const auto part = [&](size_t j) { return parts[j].second; };
  const OpKind kind = op.kind;
  if (kind == OpKind::Add) return on(moved(interval, other(1 - k), part(1 - k), true));
  if (kind == OpKind::Sub && k == 0) return on(moved(interval, other(1), part(1), false));
  if (kind == OpKind::Sub) return on(moved(mirrored(interval), other(0), part(0), false));
  if (kind == OpKind::Neg) return on(mirrored(interval));
  if (kind == OpKind::Max) return on(held(interval, parts[k], parts[1 - k], true));
  if (kind == OpKind::Min) return on(held(interval, parts[k], parts[1 - k], false));
  if (kind == OpKind::Clamp) return on(held(held(interval, parts[0], parts[2], false), parts[0], parts[1], true));
  if (kind == OpKind::Mul) return on(scaled(interval, *constant(other(1 - k), part(1 - k))));
  if (kind == OpKind::Div) return on(divided(interval, *constant(other(1), part(1))));
  if (kind == OpKind::Abs) {
    on(positive(interval, 0));
    return on(mirrored(positive(interval, 1)));
  }
  if (kind == OpKind::Mod) {
    Interval wrapped = interval;
    wrapped.modulo = places_.at(other(1), part(1));
    const ValueId below = apply(OpKind::Less, interval.first, wrapped.modulo);
    const ValueId inside = both(apply(OpKind::LessEqual, number(0), interval.first), below);
    wrapped.when = both(interval.when, inside);
    return on(wrapped);
  }
  DR_ASSERT(hands_on(kind));
  on(interval);
}

Interval Preimage::moved(Interval interval, ValueId v, int c, bool back) {
  const ValueId by = places_.at(v, c);
  const Range size = range(v, c);
  const OpKind kind = back ? OpKind::Sub : OpKind::Add;
  const bool single = interval.is_single();
  interval.first = apply(kind, interval.first, by);
  interval.last = single ? interval.first : apply(kind, interval.last, by);
  interval.below = back ? dims_difference(interval.below, size.least) : dims_sum(interval.below, size.most);
  interval.above = back ? dims_difference(interval.above, size.most) : dims_sum(interval.above, size.least);
  return interval;
}

Interval Preimage::mirrored(const Interval& interval) {
  Interval out = interval;
  out.first = ops::neg(to_, interval.last);
  out.last = interval.is_single() ? out.first : ops::neg(to_, interval.first);
  out.below = dims_difference(Dim(0), interval.above);
  out.above = dims_difference(Dim(0), interval.below);
  std::swap(out.opens_below, out.opens_above);
  return out;
}

// Whether max(v, limit) can be `limit`, or min(v, limit).
bool Preimage::holds(const Part& v, const Part& limit, bool below) {
  if (limit.second < 0) return true;
  const Range of = range(v.first, v.second), size = range(limit.first, limit.second);
  const auto room = number_of(below ? dims_difference(of.least, size.most) : dims_difference(size.least, of.most));
  return !room || *room < 0;
}

// The values that max(v, limit) takes there, or min(v, limit).
Interval Preimage::held(Interval interval, const Part& v, const Part& limit_part, bool below) {
  if (!holds(v, limit_part, below)) return interval;
  const ValueId limit = places_.at(limit_part.first, limit_part.second);
  const Range size = range(limit_part.first, limit_part.second);
  ValueId& end = below ? interval.first : interval.last;
  const ValueId inner = below ? interval.last : interval.first;
  const ValueId reached = below ? apply(OpKind::LessEqual, end, limit) : apply(OpKind::LessEqual, limit, end);
  const ValueId inside = below ? apply(OpKind::LessEqual, limit, inner) : apply(OpKind::LessEqual, inner, limit);
  end = ops::select(to_, reached, number(below ? -kBeyond : kBeyond), end);
  interval.when = both(interval.when, inside);
  const Dim wide = Dim(interval.width - 1);
  if (below) {
    interval.opens_below = true;
    interval.below = dims_sum(size.most, wide);
  } else {
    interval.opens_above = true;
    interval.above = dims_difference(size.least, wide);
  }
  return interval;
}

Interval Preimage::scaled(Interval interval, int64_t factor) {
  if (factor < 0) return scaled(mirrored(interval), -factor);
  if (factor == 1) return interval;
  const ValueId by = number(factor);
  const auto rest = [&](ValueId x) { return apply(OpKind::Mod, x, by); };
  if (interval.is_single()) {
    const ValueId zero = number(0);
    interval.when = both(interval.when, apply(OpKind::Equal, rest(interval.first), zero));
    interval.first = interval.last = apply(OpKind::Div, interval.first, by);
  } else {
    const ValueId up = apply(OpKind::Add, interval.first, number(factor - 1));
    interval.first = apply(OpKind::Div, apply(OpKind::Sub, up, rest(up)), by);
    interval.last = apply(OpKind::Div, apply(OpKind::Sub, interval.last, rest(interval.last)), by);
  }
  interval.below = interval.above = std::nullopt;
  return interval;
}

Interval Preimage::divided(Interval interval, int64_t factor) {
  if (factor == 1) return interval;
  const ValueId by = number(factor), far = number(kBeyond / factor), more = number(factor - 1);
  const auto times = [&](ValueId x) {
    return apply(OpKind::Mul, apply(OpKind::Min, apply(OpKind::Max, x, ops::neg(to_, far)), far), by);
  };
  const ValueId first = times(interval.first), last = times(interval.last);
  // Towards zero: what comes to 0 lies on both sides of it.
  const ValueId less = apply(OpKind::Sub, first, more);
  interval.first = ops::select(to_, apply(OpKind::LessEqual, first, number(0)), less, first);
  const ValueId greater = apply(OpKind::Add, last, more);
  interval.last = ops::select(to_, apply(OpKind::LessEqual, number(0), last), greater, last);
  interval.width = std::min(kBeyond, interval.width * factor + factor - 1);
  interval.below = interval.above = std::nullopt;
  return interval;
}

// What of an interval is `least` or more.
Interval Preimage::positive(Interval interval, int64_t least) {
  if (interval.is_single()) {
    interval.when = both(interval.when, apply(OpKind::LessEqual, number(least), interval.first));
  } else {
    interval.first = apply(OpKind::Max, interval.first, number(least));
  }
  return interval;
}

int64_t Preimage::bound(const Interval& interval, Variable variable) const {
  const Trips& trips = variables_[static_cast<size_t>(variable)];
  const auto all = number_of(dims_sum(dims_difference(trips.last, trips.first), Dim(1)));
  int64_t bound = interval.width;
  // One that is open at both ends holds no more than what is open at one and at the other.
  int64_t open = 0;
  const auto add = [&](bool opens, const std::optional<Dim>& from, const std::optional<Dim>& to) {
    const auto trips_there = number_of(dims_sum(dims_difference(to, from), Dim(1)));
    if (opens) open = trips_there && open >= 0 ? open + std::max<int64_t>(*trips_there, 0) : -1;
  };
  add(interval.opens_below, trips.first, interval.below);
  add(interval.opens_above, interval.above, trips.last);
  if (open < 0) return all ? *all : -1;
  bound = std::max(bound, open);
  return all ? std::min(bound, *all) : bound;
}

ValueId Preimage::number(int64_t x) { return ops::constant(to_, kInt, static_cast<double>(x)); }
ValueId Preimage::apply(OpKind kind, ValueId a, ValueId b) { return ops::emit(to_, kind, {a, b}); }
ValueId Preimage::both(ValueId a, ValueId b) {
  if (!a.valid() || !b.valid()) return a.valid() ? a : b;
  return apply(OpKind::LogicalAnd, a, b);
}

}  // namespace dr::passes
