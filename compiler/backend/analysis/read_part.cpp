// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/analysis/read_part.h"

#include <algorithm>
#include <cmath>

namespace dr::backend {

using ir::Graph;
using ir::Op;
using ir::OpId;
using ir::OpKind;
using ir::ValueId;

namespace {

// Longer sums, and larger factors, are no indices that one would share.
constexpr int kMostParts = 64;
constexpr int64_t kMostTimes = 1 << 16;

class Reader {
 public:
  Reader(const Graph& graph, OpId loop, const std::array<int, 3>& box, int trips, ChangingAxes& changing)
      : graph_(graph), loop_(loop), box_(box), trips_(trips), changing_(changing) {}

  std::optional<ReadPart> of(const Op& gather) {
    const ValueId index = gather.operands[1];
    const ir::Extent& image = graph_.value(gather.operands[0]).extent;
    const int rows = graph_.value(index).type.rows;
    ReadPart part;
    for (int c = 0; c < rows; ++c)
      if (!add(part.at[static_cast<size_t>(c)], index, c, 1)) return std::nullopt;
    if (rows < 3 && !image.l.is_one()) part.at[2].terms.push_back({.axis = 2, .trip = {}});
    for (ReadPart::Component& component : part.at)
      if (!measure(component)) return std::nullopt;
    // Rows of an odd length: what stands in one column of them does not meet in one bank of shared memory.
    if (part.elements() > part.at[0].extent) part.at[0].extent |= 1;
    return part;
  }

 private:
  std::optional<int64_t> number(ValueId v, int c) const {
    const OpId id = graph_.value(v).op;
    if (!id.valid()) return std::nullopt;
    const Op& op = graph_.op(id);
    if (op.kind == OpKind::Broadcast || op.kind == OpKind::Splat) return number(op.operands[0], c);
    if (op.kind != OpKind::Const || op.attrs.floats.empty()) return std::nullopt;
    const double x = op.attrs.floats[op.attrs.floats.size() == 1 ? 0 : static_cast<size_t>(c)];
    if (!(std::abs(x) <= static_cast<double>(kMostTimes))) return std::nullopt;
    return static_cast<int64_t>(x);
  }

  // Adds `times` component c of an integer to the sum.
  bool add(ReadPart::Component& sum, ValueId v, int c, int64_t times) {
    if (--left_ < 0 || std::abs(times) > kMostTimes) return false;
    if (const auto x = number(v, c)) {
      sum.constant += *x * times;
      return true;
    }
    const ir::ValueInfo& info = graph_.value(v);
    if (!info.op.valid()) return add_trip(sum, v, times);
    const Op& op = graph_.op(info.op);
    const auto component_of = [&](ValueId x) { return graph_.value(x).type.is_scalar() ? 0 : c; };
    const auto operand = [&](size_t k, int64_t by) {
      return add(sum, op.operands[k], component_of(op.operands[k]), by);
    };
    if (op.kind == OpKind::Coord) {
      const auto axis = static_cast<int>(op.attrs.ints[0]);
      if (!op.attrs.dims[static_cast<size_t>(axis)].is_one())
        sum.terms.push_back({.axis = axis, .trip = {}, .times = times});
      return true;
    }
    if (op.kind == OpKind::Broadcast || op.kind == OpKind::Splat) return operand(0, times);
    if (op.kind == OpKind::Compose) return add(sum, op.operands[static_cast<size_t>(c)], 0, times);
    if (op.kind == OpKind::Extract) return add(sum, op.operands[0], static_cast<int>(op.attrs.ints[0]), times);
    if (op.kind == OpKind::Add || op.kind == OpKind::Sub)
      return operand(0, times) && operand(1, op.kind == OpKind::Add ? times : -times);
    if (op.kind == OpKind::Mul)
      for (const size_t k : {size_t{0}, size_t{1}})
        if (const auto x = number(op.operands[k], component_of(op.operands[k]))) return operand(1 - k, *x * times);
    return add_other(sum, v, times);
  }

  bool add_trip(ReadPart::Component& sum, ValueId v, int64_t times) {
    const ir::RegionId region = graph_.value(v).region;
    const OpId parent = graph_.region(region).parent;
    if (!parent.valid() || graph_.op(parent).kind != OpKind::Reduce) return false;
    if (!is_inside(region)) return add_other(sum, v, times);
    int64_t first = 0;
    if (parent != loop_) {
      const auto fixed = fixed_trips(graph_, graph_.op(parent));
      if (!fixed) return false;
      first = fixed->first;
    }
    sum.terms.push_back({.axis = -1, .trip = v, .times = times, .first = first});
    return true;
  }

  bool add_other(ReadPart::Component& sum, ValueId v, int64_t times) {
    if (is_inside(graph_.value(v).region) || !graph_.value(v).type.is_scalar()) return false;
    const Axes changes = changing_.of(v);
    for (size_t axis = 0; axis < 3; ++axis)
      if (((changes >> axis) & 1) != 0 && box_[axis] > 1) return false;
    sum.others.emplace_back(v, times);
    return true;
  }

  // Whether a region is that of the loop, or stands in it.
  bool is_inside(ir::RegionId region) const {
    while (region != graph_.root()) {
      const OpId parent = graph_.region(region).parent;
      if (!parent.valid()) return false;
      if (parent == loop_) return true;
      region = graph_.op(parent).parent;
    }
    return false;
  }

  // Terms of one thing are joined; then the extent.
  bool measure(ReadPart::Component& component) const {
    std::vector<ReadPart::Term> joined;
    for (const ReadPart::Term& term : component.terms) {
      const auto same = std::ranges::find_if(
          joined, [&](const ReadPart::Term& t) { return t.axis == term.axis && t.trip == term.trip; });
      if (same == joined.end())
        joined.push_back(term);
      else
        same->times += term.times;
    }
    std::erase_if(joined, [](const ReadPart::Term& t) { return t.times == 0; });
    component.terms = std::move(joined);
    for (const ReadPart::Term& term : component.terms) {
      if (term.times < 0) return false;
      component.extent += term.times * (range_of(term) - 1);
    }
    return component.extent <= kMostTimes;
  }

  int64_t range_of(const ReadPart::Term& term) const {
    if (term.axis >= 0) return box_[static_cast<size_t>(term.axis)];
    const OpId parent = graph_.region(graph_.value(term.trip).region).parent;
    if (parent == loop_) return trips_;
    return std::clamp<int64_t>(fixed_trips(graph_, graph_.op(parent))->count, 1, kMostTimes);
  }

  const Graph& graph_;
  const OpId loop_;
  const std::array<int, 3>& box_;
  const int trips_;
  ChangingAxes& changing_;
  int left_ = kMostParts;
};

void add_gathers(const Graph& graph, const Op& op, std::vector<OpId>& out) {
  for (const ir::RegionId region : op.regions)
    for (const OpId id : graph.region(region).ops) {
      const Op& inner = graph.op(id);
      if (inner.kind == OpKind::Gather) out.push_back(id);
      add_gathers(graph, inner, out);
    }
}

}  // namespace

std::optional<FixedTrips> fixed_trips(const Graph& graph, const Op& loop) {
  int64_t bounds[2] = {};
  for (const size_t k : {size_t{0}, size_t{1}}) {
    const OpId id = graph.value(loop.operands[k]).op;
    if (!id.valid()) return std::nullopt;
    const Op& op = graph.op(id);
    if (op.kind == OpKind::Const && std::abs(op.attrs.floats[0]) < 1e9)
      bounds[k] = static_cast<int64_t>(op.attrs.floats[0]);
    else if (op.kind == OpKind::DimValue && op.attrs.dims[0].is_constant())
      bounds[k] = op.attrs.dims[0].constant();
    else
      return std::nullopt;
  }
  return FixedTrips{bounds[0], std::max<int64_t>(bounds[1] - bounds[0], 0)};
}

std::optional<ReadPart> read_part(const Graph& graph, const Op& gather, OpId loop, const std::array<int, 3>& box,
                                  int trips, ChangingAxes& changing) {
  return Reader(graph, loop, box, trips, changing).of(gather);
}

std::vector<OpId> gathers_in(const Graph& graph, const Op& op) {
  std::vector<OpId> out;
  add_gathers(graph, op, out);
  return out;
}

}  // namespace dr::backend
