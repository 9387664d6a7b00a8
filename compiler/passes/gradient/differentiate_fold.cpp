// SPDX-License-Identifier: Apache-2.0
// The adjoint of a Fold of n sweeps is a Fold of 2n: the first n are the Fold's own, without what only its other
// results take; then come the adjoints of its sweeps, the last one's first. An adjoint sweep runs against the direction
// of its sweep and carries the adjoints of its states. At a trip it sees the states that all sweeps had there, so it
// replays the trip and runs the reverse sweep over it.
//   %r = fold %a, %b, %x { (%i, %s) %t = mul %s, %s; yield %t }
//     =>  %dx = fold %a, %b, %x, %dr { (%i, %s) %t = mul %s, %s; yield %t } { (%i, %s, %g) %u = smul %g, %s; ..; yield
//     %v }
// The states that a sweep starts with have the adjoints after the last adjoint sweep. For those of a later sweep that
// is an earlier end, and a Fold of its own. What sweeps capture and read gets its adjoint summed over the trips of the
// very last.
#include <set>

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
using ir::ResultType;
using ir::ValueId;
using ir::Yield;
using ir::Yielded;
using ir::yielded;

namespace {

class FoldAdjoint {
 public:
  FoldAdjoint(Sweep& sweep, Frame& outer, const Op& op, std::span<const ResultAdjoint> adjoints)
      : sweep_(sweep),
        b_(sweep.builder),
        outer_(outer),
        op_(op),
        adjoints_(adjoints),
        sweeps_(ir::fold_sweeps(op)),
        domain_(adjoint_domain(outer, op)),
        active_(sweeps_) {
    for (size_t s = 0; s < sweeps_; ++s) {
      const std::span<const ValueId> states = ir::fold_params(sweep.source, op, s, s);
      for (size_t k = 0; k < states.size(); ++k)
        if (sweep.active[states[k].index]) active_[s].push_back(k);
    }
  }

  void run() {
    for (size_t of = sweeps_; of-- > 0;)
      if (of == 0 || !active_[of].empty()) emit(of);
  }

 private:
  // Up to the adjoint sweep of sweep `of`.
  void emit(size_t of) {
    Attrs attrs;
    attrs.ints = {op_.attrs.ints[0], op_.attrs.ints[1]};
    append_extent(attrs, domain_);
    std::vector<ValueId> operands{sweep_.now[op_.operands[0]], sweep_.now[op_.operands[1]]};
    std::vector<RegionId> regions;
    for (size_t s = 0; s < sweeps_; ++s) {
      attrs.ints.push_back(static_cast<int64_t>(ir::fold_states(op_, s)));
      for (const ValueId start : ir::fold_starts(op_, s)) operands.push_back(sweep_.now[start]);
      regions.push_back(copy_sweep(s));
    }
    std::vector<ValueId> captured, images;
    for (size_t s = sweeps_; s-- > of;) {
      attrs.ints.push_back(static_cast<int64_t>(active_[s].size()));
      for (const size_t k : active_[s]) operands.push_back(end_adjoint(s, k));
      regions.push_back(adjoint_sweep(s, s == of, attrs, captured, images));
    }
    const std::vector<ValueId> results =
        ops::emit_multi(b_, OpKind::Fold, std::move(operands), std::move(attrs), std::move(regions));
    const std::span<const ValueId> starts = ir::fold_starts(op_, of);
    for (size_t k = 0; k < active_[of].size(); ++k) {
      const ValueId start = starts[active_[of][k]];
      const Extent& extent = sweep_.source.value(start).extent;
      sweep_.add(outer_, start, outer_.root ? ops::reduce_to(b_, results[k], extent) : results[k]);
    }
    if (of == 0) collect(sweep_, outer_, captured, images, std::span(results).subspan(active_[of].size()));
  }

  // The parameters of a sweep's own region: what is nested in it may run on fewer elements than the adjoint does.
  std::vector<ResultType> own_parameters(size_t s) const {
    std::vector<ResultType> params;
    for (const ValueId param : sweep_.source.region(op_.regions[s]).params) {
      const ir::ValueInfo& info = sweep_.source.value(param);
      params.push_back({.type = info.type, .extent = info.extent});
    }
    return params;
  }

  ir::Type type_of(size_t s, size_t k) const { return sweep_.source.value(ir::fold_starts(op_, s)[k]).type; }

  // A copy of a sweep that yields its states alone.
  RegionId copy_sweep(size_t s) {
    const RegionId region = b_.begin_region(own_parameters(s));
    bind(s, region);
    std::vector<ValueId> values;
    if (s == 0 && ir::fold_stops(op_)) values.push_back(ir::fold_stop(sweep_.source, op_));
    for (const ValueId next : ir::fold_next(sweep_.source, op_, s)) values.push_back(next);
    replay(sweep_, op_.regions[s], values);
    for (ValueId& value : values) value = sweep_.now[value];
    b_.end_region(std::move(values));
    return region;
  }

  // What a sweep's parameters are in a region whose first ones are those of the last sweep, or its own.
  void bind(size_t s, RegionId region) {
    const std::vector<ValueId>& from = sweep_.source.region(op_.regions[s]).params;
    for (size_t k = 0; k < from.size(); ++k) sweep_.now.set(from[k], b_.graph().region(region).params[k]);
  }

  // The adjoint of a state of sweep `s` after its last trip.
  ValueId end_adjoint(size_t s, size_t k) {
    if (s + 1 == sweeps_ && adjoints_[k].element.valid()) return adjoints_[k].element;
    return ops::constant(b_, type_of(s, k), 0.0);
  }

  RegionId adjoint_sweep(size_t s, bool last, Attrs& attrs, std::vector<ValueId>& captured,
                         std::vector<ValueId>& images) {
    std::vector<ResultType> params = own_parameters(sweeps_ - 1);
    size_t at = params.size();
    for (size_t of = sweeps_; of-- > s;)
      for (const size_t k : active_[of]) params.push_back({.type = type_of(of, k), .extent = domain_});
    const RegionId region = b_.begin_region(params);
    Frame frame{.root = false, .domain = domain_, .adjoints = {}, .accumulated = {}, .scatters = {}};
    for (size_t of = sweeps_; of-- > s;) {
      bind(of, region);
      reverse_trip(frame, of, region, at);
      at += active_[of].size();
    }
    std::vector<ValueId> yields;
    for (const size_t k : active_[s]) {
      yields.push_back(state_adjoint(frame, s, k));
      if (last) attrs.yields.push_back(Yield::Element);
    }
    if (last && s == 0) yield_captured(sweep_, frame, op_.regions, attrs, yields, captured, images);
    if (last && attrs.yields.empty()) {  // as in differentiate_if.cpp
      yields.push_back(ops::constant(b_, ir::kFloat, 0.0));
      attrs.yields.push_back(Yield::Sum);
    }
    b_.end_region(std::move(yields));
    return region;
  }

  // The reverse sweep over one trip of sweep `s`; the adjoints of its states are the region's parameters from `at` on.
  void reverse_trip(Frame& frame, size_t s, RegionId region, size_t at) {
    const std::span<const ValueId> next = ir::fold_next(sweep_.source, op_, s);
    std::vector<ValueId> values;
    for (const size_t k : active_[s]) values.push_back(next[k]);
    std::vector<Yielded> others;
    if (s + 1 == sweeps_) others = yielded(sweep_.source, op_, op_.regions[s]);
    const auto flows = [&](size_t k) { return adjoints_[k].any() && sweep_.active[others[k].value.index]; };
    for (size_t k = next.size(); k < others.size(); ++k) {
      if (!flows(k)) continue;
      values.push_back(others[k].value);
      if (others[k].index.valid()) values.push_back(others[k].index);
    }
    replay(sweep_, op_.regions[s], values);
    for (size_t k = 0; k < active_[s].size(); ++k)
      sweep_.add(frame, next[active_[s][k]], b_.graph().region(region).params[at + k]);
    for (size_t k = next.size(); k < others.size(); ++k)
      if (flows(k)) add_result(frame, others[k], adjoints_[k]);
    sweep_.run(frame, sweep_.source.region(op_.regions[s]).ops);
  }

  void add_result(Frame& frame, const Yielded& yield, const ResultAdjoint& adjoint) {
    if (adjoint.element.valid()) sweep_.add(frame, yield.value, adjoint.element);
    for (const ValueId image : adjoint.images) {
      if (yield.index.valid()) {
        sweep_.add(frame, yield.value, ops::emit(b_, OpKind::Gather, {image, sweep_.now[yield.index]}));
      } else {
        frame.accumulated[yield.value].push_back(image);
      }
    }
  }

  // The sum of what the sweep's own trip and those of later sweeps make of a state.
  ValueId state_adjoint(const Frame& frame, size_t s, size_t k) {
    ValueId sum;
    for (size_t in = s; in < sweeps_; ++in) {
      const auto found = frame.adjoints.find(ir::fold_params(sweep_.source, op_, in, s)[k]);
      if (found == frame.adjoints.end()) continue;
      sum = sum.valid() ? ops::add(b_, sum, found->second) : found->second;
    }
    return sum.valid() ? sum : ops::constant(b_, type_of(s, k), 0.0);
  }

  Sweep& sweep_;
  Builder& b_;
  Frame& outer_;
  const Op& op_;
  std::span<const ResultAdjoint> adjoints_;
  size_t sweeps_;
  Extent domain_;
  std::vector<std::vector<size_t>> active_;  // by sweep: the states that have adjoints
};

}  // namespace

void differentiate_fold(Sweep& sweep, Frame& frame, ir::OpId id) {
  const Op& op = sweep.source.op(id);
  const std::vector<ResultAdjoint> adjoints = result_adjoints(sweep, frame, op);
  if (any(adjoints)) FoldAdjoint(sweep, frame, op, adjoints).run();
}

}  // namespace dr::passes
