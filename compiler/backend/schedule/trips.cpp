// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/schedule/trips.h"

#include <algorithm>
#include <cmath>
#include <iterator>

#include "compiler/backend/analysis/alike_branches.h"
#include "compiler/backend/analysis/apart.h"
#include "compiler/backend/analysis/fold_memory.h"
#include "compiler/backend/analysis/raster_parts.h"
#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/bundle/entries.h"
#include "compiler/ir/dim_bound.h"
#include "compiler/ir/yields.h"

namespace dr::backend {

using ir::Dim;
using ir::Graph;
using ir::most_of;
using ir::never_above_zero;
using ir::Op;
using ir::OpKind;
using ir::ValueId;

namespace {

// Longer chains of arithmetic say nothing.
constexpr int kMostValues = 1000;
using Bound = std::optional<Dim>;

// A bound that holds for whichever of the two it is.
Bound larger(const Bound& a, const Bound& b) {
  if (!a || !b) return std::nullopt;
  if (never_above_zero(*a - *b)) return b;
  if (never_above_zero(*b - *a)) return a;
  return most_of(*a) + most_of(*b);
}
Bound smaller(const Bound& a, const Bound& b) {
  if (!a || !b) return std::nullopt;
  if (never_above_zero(*a - *b)) return a;
  if (never_above_zero(*b - *a)) return b;
  return std::nullopt;
}
// Of two bounds that both hold. Where nothing is known of them, a number says more than an extent, unless it is larger
// than those of pictures.
Bound either(const Bound& a, const Bound& b, bool least) {
  if (!a || !b) return a ? a : b;
  constexpr int64_t kFar = 1 << 20;
  const auto is_far = [](const Dim& d) { return d.is_constant() && std::abs(d.constant()) > kFar; };
  return never_above_zero(least ? *a - *b : *b - *a)       ? a
         : never_above_zero(least ? *b - *a : *a - *b)     ? b
         : is_far(*b) || (a->is_constant() && !is_far(*a)) ? a
                                                           : b;
}

class Finder {
 public:
  explicit Finder(const Graph& graph) : graph_(graph) {}

  // Between whole numbers a rounded number stays between them.
  static constexpr OpKind kKeepsBounds[] = {OpKind::Broadcast, OpKind::Pin,     OpKind::Detach,
                                            OpKind::Splat,     OpKind::Extract, OpKind::Floor,
                                            OpKind::Ceil,      OpKind::Round,   OpKind::Trunc};

  Bounds of(ValueId v) {
    const ir::ValueInfo& info = graph_.value(v);
    if (--left_ < 0) return {};
    if (!info.op.valid()) return of_param(info);
    const Op& op = graph_.op(info.op);
    const auto arg = [&](size_t k) { return of(op.operands[k]); };
    const OpKind kind = op.kind;
    if (kind == OpKind::Const) return of_const(op);
    if (kind == OpKind::DimValue) return {op.attrs.dims[0], op.attrs.dims[0]};
    if (kind == OpKind::Coord) return {Dim(0), op.attrs.dims[static_cast<size_t>(op.attrs.ints[0])] - Dim(1)};
    if (kind == OpKind::StepIndex) return {Dim(0), {}};
    if (std::ranges::find(kKeepsBounds, kind) != std::end(kKeepsBounds)) return arg(0);
    if (kind == OpKind::Convert) return of_convert(op, info, arg(0));
    if (kind == OpKind::Compose) {
      Bounds all = arg(0);
      for (size_t k = 1; k < op.operands.size(); ++k) all = hull(all, arg(k));
      return all;
    }
    if (kind == OpKind::Select) return hull(arg(1), arg(2));
    if (kind == OpKind::Min || kind == OpKind::Max || kind == OpKind::Clamp) return of_choice(op, arg);
    if (kind == OpKind::If) {
      const Bounds then = of(yield_of(op, 0, info.result_index));
      return hull(then, of(yield_of(op, 1, info.result_index)));
    }
    if (kind == OpKind::Reduce) {
      if (op.attrs.yields[info.result_index] != ir::Yield::ArgMin) return {};
      const Bounds begin = arg(0), end = arg(1);
      return {begin.low ? Bound(*begin.low - Dim(1)) : Bound(), larger(begin.high, end.high)};
    }
    return info.type.scalar == ir::Scalar::Int ? of_arithmetic(op, arg) : Bounds{};
  }

  // What `end` is above `begin` at most.
  Bound difference(ValueId end, ValueId begin) {
    const std::optional<int64_t> apart = most_apart(graph_, end, begin);
    Bound bounds = by_bounds(end, begin);
    if (bounds && bounds->is_constant()) bounds = Dim(std::max<int64_t>(bounds->constant(), 0));
    if (!apart) return bounds;
    // Few trips whatever the extents are; many may be far more than these allow.
    constexpr int64_t kFew = 1 << 10;
    const Dim known(std::max<int64_t>(*apart, 0));
    if (!bounds || (!bounds->is_constant() && known.constant() <= kFew)) return known;
    return bounds->is_constant() ? either(known, bounds, true) : bounds;
  }

 private:
  Bound by_bounds(ValueId end, ValueId begin) {
    if (end == begin) return Dim(0);
    const ir::ValueInfo& info = graph_.value(end);
    const Bounds high = of(end), low = of(begin);
    const Bound apart = high.high && low.low ? Bound(*high.high - *low.low) : Bound();
    if (!info.op.valid() || left_ < 0) return apart;
    const Op& op = graph_.op(info.op);
    const auto of_operand = [&](size_t k) { return by_bounds(op.operands[k], begin); };
    if (op.kind == OpKind::Min) return either(apart, either(of_operand(0), of_operand(1), true), true);
    if (op.kind == OpKind::Add)
      for (const size_t k : {size_t{0}, size_t{1}})
        if (const auto rest = of_operand(k), more = of(op.operands[1 - k]).high; rest && more)
          return either(apart, *rest + *more, true);
    return apart;
  }

  static Bounds hull(const Bounds& a, const Bounds& b) { return {smaller(a.low, b.low), larger(a.high, b.high)}; }

  ValueId yield_of(const Op& op, size_t branch, uint32_t result) const {
    // Before a result stand yields of one value each, or of two where they scatter; what scatters is no number.
    size_t at = 0;
    const auto& yields = graph_.region(op.regions[branch]).yields;
    for (uint32_t k = 0; k < result; ++k)
      at += op.attrs.yields[k] == ir::Yield::Scatter && !graph_.value(yields[at]).accumulation ? 2 : 1;
    return yields[at];
  }

  Bounds of_param(const ir::ValueInfo& info) {
    const ir::OpId parent = graph_.region(info.region).parent;
    if (!parent.valid() || graph_.op(parent).kind != OpKind::Reduce) return {};
    const Op& loop = graph_.op(parent);
    const Bound last = of(loop.operands[1]).high;
    return {of(loop.operands[0]).low, last ? Bound(*last - Dim(1)) : Bound()};
  }

  static Bounds of_const(const Op& op) {
    Bounds all;
    for (const double x : op.attrs.floats) {
      if (!(std::abs(x) < 9e15)) return {};
      const Bounds one{Dim(static_cast<int64_t>(std::floor(x))), Dim(static_cast<int64_t>(std::ceil(x)))};
      all = all.low ? hull(all, one) : one;
    }
    return all;
  }

  Bounds of_convert(const Op& op, const ir::ValueInfo& info, const Bounds& x) const {
    const bool from_float = graph_.value(op.operands[0]).type.is_float();
    if (info.type.is_float()) {
      // Large integers are rounded.
      if (!x.high) return {x.low, {}};
      return {x.low && x.low->is_constant() && std::abs(x.low->constant()) < 1 << 24 ? x.low : Bound(),
              *x.high + most_of(*x.high).divided_by(1 << 23)};
    }
    if (!from_float) return x;
    return {smaller(x.low, Dim(0)), larger(x.high, Dim(0))};  // of NaN it is 0
  }

  template <class Arg>
  static Bounds of_choice(const Op& op, const Arg& arg) {
    const Bounds a = arg(0), b = arg(1);
    if (op.kind == OpKind::Min) return {smaller(a.low, b.low), either(a.high, b.high, true)};
    if (op.kind == OpKind::Max) return {either(a.low, b.low, false), larger(a.high, b.high)};
    const Bounds high = arg(2);
    return {smaller(either(a.low, b.low, false), high.low), either(high.high, larger(a.high, b.high), true)};
  }

  template <class Arg>
  static Bounds of_arithmetic(const Op& op, const Arg& arg) {
    const auto plus = [](const Bound& a, const Bound& b) { return a && b ? Bound(*a + *b) : Bound(); };
    const auto minus = [](const Bound& a, const Bound& b) { return a && b ? Bound(*a - *b) : Bound(); };
    const auto constant = [](const Bounds& b) {
      return b.low && b.high && b.low->is_constant() && *b.low == *b.high && b.low->constant() > 0 ? b.low->constant()
                                                                                                   : int64_t{0};
    };
    const auto from_zero = [](const Bounds& b) { return b.low && never_above_zero(Dim(0) - *b.low); };
    if (op.kind == OpKind::Add || op.kind == OpKind::Sub) {
      const Bounds a = arg(0), b = arg(1);
      if (op.kind == OpKind::Add) return {plus(a.low, b.low), plus(a.high, b.high)};
      return {minus(a.low, b.high), minus(a.high, b.low)};
    }
    if (op.kind == OpKind::Mul) {
      const Bounds a = arg(0), b = arg(1);
      if (!from_zero(a) || !from_zero(b)) return {};
      return {*a.low * *b.low, a.high && b.high ? Bound(most_of(*a.high) * most_of(*b.high)) : Bound()};
    }
    if (op.kind == OpKind::Div) {
      const Bounds a = arg(0);
      const int64_t by = constant(arg(1));
      if (by == 0) return {};
      return {from_zero(a) ? Bound(Dim(0))
              : a.low      ? Bound(a.low->divided_by(by))
                           : Bound(),
              a.high ? Bound(most_of(*a.high).divided_by(by)) : Bound()};
    }
    if (op.kind == OpKind::Mod) {
      const Bounds by = arg(1);
      if (by.low && by.high && never_above_zero(Dim(1) - *by.low)) return {Dim(0), *by.high - Dim(1)};
    }
    return {};
  }

  const Graph& graph_;
  int left_ = kMostValues;
};

}  // namespace

Bounds bounds_of(const Graph& graph, ValueId value) { return Finder(graph).of(value); }

Trips& Trips::operator+=(const Trips& other) {
  most = most + other.most;
  loops += other.loops;
  unknown += other.unknown;
  promised += other.promised;
  even = even && other.even;
  return *this;
}

Trips trips_of_regions(const Graph& graph, const Op& op) {
  Trips all;
  for (const ir::RegionId region : op.regions) all += trips_of(graph, graph.region(region).ops);
  return all;
}

Trips trips_of(const Graph& graph, std::span<const ir::OpId> ops) {
  Trips all;
  const auto alike = [&](ValueId v) { return graph.value(v).extent.is_unit(); };
  for (const ir::OpId id : ops) {
    const Op& op = graph.op(id);
    if (op.kind != OpKind::If && op.kind != OpKind::Reduce && op.kind != OpKind::Fold) continue;
    Trips inside = trips_of_regions(graph, op);
    if (op.kind == OpKind::If) {
      inside.even = inside.loops == 0 || (inside.even && alike(op.operands[0]));
    } else if (op.kind == OpKind::Fold) {
      // Each sweep is a loop of as many trips as the first. What was not kept is computed again.
      const Dim sweeps(static_cast<int64_t>(ir::fold_sweeps(op)));
      const FoldMemory memory = fold_memory(graph, op);
      Bound most = Finder(graph).difference(op.operands[1], op.operands[0]);
      const bool has_max = ir::fold_bound(op) >= 0;
      if (!most) ++(has_max ? inside.promised : inside.unknown);
      if (most) most = most_of(*most);
      if (has_max) most = either(most, Dim(ir::fold_bound(op)), true);
      const Dim trips = most ? *most : Dim(1), again = trips_again(memory, trips);
      const int again_loops = memory.how == FoldMemory::How::Checkpoints ? 1 : 0;
      inside.most = sweeps + trips * (sweeps + Dim(again_loops) + inside.most) + again * (Dim(1) + inside.most);
      inside.even = inside.even && alike(op.operands[0]) && alike(op.operands[1]) && !ir::fold_stops(op);
      inside.loops += static_cast<int>(ir::fold_sweeps(op)) + again_loops;
    } else {
      Bound most = Finder(graph).difference(op.operands[1], op.operands[0]);
      const bool has_max = op.attrs.ints[0] >= 0;
      if (!most) ++(has_max ? inside.promised : inside.unknown);
      if (has_max) most = either(most ? Bound(most_of(*most)) : Bound(), Dim(op.attrs.ints[0]), true);
      inside.most = Dim(1) + (most ? most_of(*most) : Dim(1)) * (Dim(1) + inside.most);
      inside.even = inside.even && alike(op.operands[0]) && alike(op.operands[1]);
      ++inside.loops;
    }
    all += inside;
  }
  // A loop over branches that share a text takes one for each at most.
  for (const Together& together : alike_together(graph, ops))
    if (together.ops.size() > 1) all.most = all.most + Dim(static_cast<int64_t>(together.ops.size()) + 1);
  return all;
}

KeptPixels kept_pixels(const Schedule& schedule, const StepSchedule& step, const Op& raster) {
  const Resource& faces = schedule.resources[step.stored.at(raster.results[0]).index];
  if (faces.is(Resource::Storage::Bits)) return KeptPixels::Bits;
  return schedule.code.wide_words && !raster_parts(raster).listed ? KeptPixels::WideWords : KeptPixels::Words;
}

bool has_depths(const Graph& graph, const Op& raster, KeptPixels kept) {
  return !raster_parts(raster).listed && !(kept == KeptPixels::Bits && has_depth_always(graph, raster));
}

std::vector<ir::OpId> set_up_again(const Graph& graph, const Pass& raster, const Pass* setup, KeptPixels kept,
                                   const std::set<ValueId>& but) {
  if (setup == nullptr) return {};
  const auto is_stored = [&](ValueId v) {
    return !but.contains(v) && (contains(setup->writes, v) || contains(raster.reads, v));
  };
  std::vector<ir::OpId> ops = setup->ops;
  std::erase_if(ops, [&](ir::OpId id) { return std::ranges::all_of(graph.op(id).results, is_stored); });
  std::vector<ValueId> needed;
  const Op& op = graph.op(raster.ops.back());
  for (const ValueId v : walked_record(graph, op, has_depths(graph, op, kept)))
    if (!is_stored(v)) needed.push_back(v);
  return ops_of(graph, ops, needed);
}

WalkTrips walk_trips(const Graph& graph, const Pass& pass, const Op& op, const Pass* setup, KeptPixels kept,
                     bool in_words) {
  const Trips closures = trips_of_regions(graph, op);
  const Trips captured = trips_of(graph, {pass.ops.begin(), pass.ops.end() - 1});
  WalkTrips trips;
  const RasterParts parts = raster_parts(op);
  const bool at_once = kept == KeptPixels::WideWords || parts.listed;  // all ranks
  trips.pixel = closures.most + captured.most + Dim(at_once ? static_cast<int64_t>(parts.count) + 1 : 0);
  trips.listed = trips.pixel;
  trips.face = trips_of(graph, set_up_again(graph, pass, setup, kept)).most;
  if (in_words) {
    // Lanes share words of rows, not pixels. A box of 33 pixels a row lies in up to three words, of which a lane may
    // have all the full ones: a lane has less than three times its share of pixels, and a word more. A word takes a
    // trip, and its loop ends in one, even if there is but one pixel in it.
    const Dim pixel = trips.pixel + Dim(3);
    trips.face = trips.face + Dim(bundle::kBitsOfWord) * pixel;
    trips.listed = Dim(3) * pixel;
  }
  trips.watched = closures.unknown + closures.promised + captured.unknown + captured.promised > 0;
  return trips;
}

namespace {
// The blocks of a row are as many at most, however many items there are.
constexpr int64_t kMostRowBlocks = 1 << 14;
constexpr int64_t kRowBlock = 256;
}  // namespace

Dim row_block(const Dim& items) { return Dim(kRowBlock) * (Dim(1) + items.divided_by(kRowBlock * kMostRowBlocks)); }

Dim row_walk(const Dim& items, const Dim& item, int64_t lanes) {
  Dim blocks = kMostRowBlocks, ends = Dim(2) * row_block(items);
  if (items.is_constant()) {
    blocks = std::min(kMostRowBlocks, items.constant() / kRowBlock + 1);
    ends = std::min(ends.constant(), items.constant());
  }
  Dim waits = ends * Dim(lanes);
  if (items.is_constant()) waits = std::min(waits.constant(), (blocks + ends).constant());
  return Dim(3) + Dim(2) * (Dim(1) + blocks + ends + waits * item);
}

bool may_walk_rows(const Graph& graph, const Pass& pass, const RowsScatter& rows, const target::Profile& profile) {
  if (profile.loop_trips == 0) return true;
  const Trips item = trips_of(graph, pass.ops);
  if (item.unknown > 0) return false;
  const Dim walk = row_walk(rows.items(pass.domain), item.most, std::max(profile.subgroup_size, 1U));
  // Of as many items as a leaf says, the command tells what the walk takes, and counts none within items.
  return walk.is_constant() ? walk.constant() <= profile.loop_trips
                            : item.loops == 0 && item.most.is_constant() && item.most.constant() == 0;
}

bool may_pass_limit(const Trips& trips, const target::Profile& profile, int64_t times) {
  if (profile.loop_trips == 0 || trips.loops == 0) return false;
  const Dim all = trips.most * Dim(times);
  return !all.is_constant() || all.constant() > profile.loop_trips;
}

bool needs_cut(const Trips& trips, const target::Profile& profile, int64_t times) {
  return may_pass_limit(trips, profile, times) || (profile.loop_trips > 0 && trips.unknown > 0);
}

}  // namespace dr::backend
