// SPDX-License-Identifier: Apache-2.0
// The adjoint of Reduce. Of a sum (or scatter): a Reduce over the same range whose body replays the forward body of its
// trip, runs the reverse sweep and sums what it finds.
//   %r = reduce(%a, %b) { (%i) %v = gather %x, %i; %w = mul %v, %k; yield %w }  sum
//     =>  %dk, %dx = reduce(%a, %b) { (%i) %v = gather %x, %i; ..; %t = mul %dr, %v; %u = mul %dr, %k; yield %t, %i, %u
//     }
// Of a minimum or maximum: only the trip that won has an adjoint, the first one on ties. A second Reduce finds it
// (argmin), and the adjoint is that of a sum whose range is this one trip: it costs one trip, not all, and the trips
// that lost cannot leak a NaN. An empty range has no winner and no adjoint.
#include "compiler/ir/yields.h"
#include "compiler/ops/emit.h"
#include "compiler/passes/gradient/differentiate.h"

namespace dr::passes {

using ir::Attrs;
using ir::Builder;
using ir::Extent;
using ir::Op;
using ir::OpKind;
using ir::RegionId;
using ir::Type;
using ir::ValueId;
using ir::Yield;
using ir::Yielded;
using ir::yielded;

namespace {

// The trips of a Reduce under construction.
struct Range {
  ValueId begin;
  ValueId end;
  int64_t bound = -1;  // on their number, or -1
};

Range range_of(const Sweep& sweep, const Op& op) {
  return {.begin = sweep.now[op.operands[0]], .end = sweep.now[op.operands[1]], .bound = op.attrs.ints[0]};
}

// Opens a region like the body of `op`, with the trip number entered in `now`.
RegionId begin_body(Sweep& sweep, const Op& op) {
  const ValueId trip = sweep.source.region(op.regions[0]).params[0];
  const ir::ValueInfo& info = sweep.source.value(trip);
  const ir::ResultType type{.type = info.type, .extent = info.extent};
  const RegionId body = sweep.builder.begin_region({&type, 1});
  sweep.now.set(trip, sweep.builder.graph().region(body).params[0]);
  return body;
}

std::vector<ValueId> emit_reduce(Sweep& sweep, const Range& range, Attrs attrs, RegionId body) {
  attrs.ints = {range.bound};
  return ops::emit_multi(sweep.builder, OpKind::Reduce, {range.begin, range.end}, std::move(attrs), {body});
}

// The sum, over a range of trips, of the adjoints of what the body reads and captures.
void sum_adjoints(Sweep& sweep, Frame& outer, const Op& op, const Range& range,
                  std::span<const ResultAdjoint> adjoints) {
  Builder& b = sweep.builder;
  const Extent domain = adjoint_domain(outer, op);
  const RegionId body = begin_body(sweep, op);
  Frame frame{.root = false, .domain = domain, .adjoints = {}, .accumulated = {}, .scatters = {}};
  reverse(sweep, frame, op, op.regions[0], adjoints);

  Attrs attrs;
  append_extent(attrs, domain);
  std::vector<ValueId> captured;
  std::vector<ValueId> images;
  std::vector<ValueId> yields;
  yield_captured(sweep, frame, op.regions, attrs, yields, captured, images);
  if (yields.empty()) {  // as in differentiate_if.cpp
    yields.push_back(ops::constant(b, ir::kFloat, 0.0));
    attrs.yields.push_back(Yield::Sum);
  }
  b.end_region(std::move(yields));
  collect(sweep, outer, captured, images, emit_reduce(sweep, range, std::move(attrs), body));
}

// One component of a minimum or maximum that has an adjoint.
struct Extreme {
  size_t result = 0;
  int component = 0;
  ValueId winner;  // the trip that gave it
};

void find_winners(Sweep& sweep, const Frame& outer, const Op& op, std::vector<Extreme>& extremes) {
  const std::vector<Yielded> yields = yielded(sweep.source, op, op.regions[0]);
  // The program may have asked for the winner itself.
  std::vector<Extreme*> unknown;
  for (Extreme& extreme : extremes) {
    const ValueId value = yields[extreme.result].value;
    const bool scalar = sweep.source.value(value).type.is_scalar();
    for (size_t k = 0; k < yields.size() && scalar && op.attrs.yields[extreme.result] == Yield::Min; ++k) {
      if (op.attrs.yields[k] == Yield::ArgMin && yields[k].value == value) extreme.winner = sweep.now[op.results[k]];
    }
    if (!extreme.winner.valid()) unknown.push_back(&extreme);
  }
  if (unknown.empty()) return;

  Builder& b = sweep.builder;
  const RegionId body = begin_body(sweep, op);
  std::vector<ValueId> values;
  for (const Extreme* extreme : unknown) values.push_back(yields[extreme->result].value);
  replay(sweep, op.regions[0], values);
  Attrs attrs;
  append_extent(attrs, adjoint_domain(outer, op));
  std::vector<ValueId> keys;
  for (const Extreme* extreme : unknown) {
    ValueId key = sweep.now[yields[extreme->result].value];
    if (!b.value(key).type.is_scalar()) key = ops::extract(b, key, extreme->component);
    keys.push_back(op.attrs.yields[extreme->result] == Yield::Max ? ops::neg(b, key) : key);
    attrs.yields.push_back(Yield::ArgMin);
  }
  b.end_region(std::move(keys));
  const std::vector<ValueId> winners = emit_reduce(sweep, range_of(sweep, op), std::move(attrs), body);
  for (size_t k = 0; k < unknown.size(); ++k) unknown[k]->winner = winners[k];
}

void differentiate_extreme(Sweep& sweep, Frame& outer, const Op& op, const Extreme& extreme, ValueId adjoint) {
  Builder& b = sweep.builder;
  const Type type = b.value(adjoint).type;
  if (!type.is_scalar()) {
    std::vector<ValueId> parts(static_cast<size_t>(type.rows), ops::constant(b, type.element(), 0.0));
    const size_t at = static_cast<size_t>(extreme.component);
    parts[at] = ops::extract(b, adjoint, extreme.component);
    adjoint = ops::compose(b, parts, type);
  }
  std::vector<ResultAdjoint> adjoints(op.results.size());
  adjoints[extreme.result].element = adjoint;

  const ValueId begin = sweep.now[op.operands[0]];
  const ValueId has_winner = ops::emit(b, OpKind::LessEqual, {begin, extreme.winner});
  const ValueId next = ops::add(b, extreme.winner, ops::constant(b, ir::kInt, 1.0));
  const Range range{.begin = extreme.winner, .end = ops::select(b, has_winner, next, extreme.winner), .bound = 1};
  sum_adjoints(sweep, outer, op, range, adjoints);
}

}  // namespace

void differentiate_reduce(Sweep& sweep, Frame& frame, ir::OpId id) {
  const Op& op = sweep.source.op(id);
  const std::vector<ResultAdjoint> adjoints = result_adjoints(sweep, frame, op);
  std::vector<ResultAdjoint> sums = adjoints;
  std::vector<Extreme> extremes;
  for (size_t k = 0; k < adjoints.size(); ++k) {
    if (op.attrs.yields[k] != Yield::Min && op.attrs.yields[k] != Yield::Max) continue;
    sums[k] = {};
    if (!adjoints[k].any()) continue;
    const Type type = sweep.source.value(op.results[k]).type;
    DR_ASSERT(!type.is_matrix());
    for (int c = 0; c < type.components(); ++c) extremes.push_back({.result = k, .component = c, .winner = {}});
  }
  if (any(sums)) sum_adjoints(sweep, frame, op, range_of(sweep, op), sums);
  if (extremes.empty()) return;
  find_winners(sweep, frame, op, extremes);
  for (const Extreme& extreme : extremes) {
    differentiate_extreme(sweep, frame, op, extreme, adjoints[extreme.result].element);
  }
}

}  // namespace dr::passes
