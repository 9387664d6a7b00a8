// SPDX-License-Identifier: Apache-2.0
// Trips, sweeps over them, and the states that they pass on.
#include "compiler/reference/fold.h"

#include <algorithm>
#include <cmath>

#include "compiler/ir/yields.h"

namespace dr::reference {

using ir::Yield;

namespace {

constexpr double kKeptNumbers = 1 << 22;  // of states, at a time

}  // namespace

FoldRun::FoldRun(RegionRunner& runner, Frame& frame, const OpPlan& plan)
    : runner_(runner),
      frame_(frame),
      plan_(plan),
      op_(*plan.op),
      begin_(runner.get(frame, plan.operands[0])),
      end_(runner.get(frame, plan.operands[1])),
      states_(ir::fold_sweeps(op_)),
      sums_(plan.results.size()) {}

void FoldRun::run() {
  start_states();
  const size_t last = states_.size() - 1;
  for (size_t k = states_[last].size(); k < sums_.size(); ++k) {
    sums_[k].type = frame_.plan->slots[plan_.results[k]].type;
    if (op_.attrs.yields[k] == Yield::Sum) sums_[k].now.assign(components(sums_[k].type) * frame_.n, 0.0);
  }
  const double bound = ir::fold_bound(op_) < 0 ? INFINITY : static_cast<double>(ir::fold_bound(op_));
  double trips = 1, numbers = 1;
  for (size_t i = 0; i < frame_.n; ++i) trips = std::max(trips, std::min(bound, end_.at(0, i) - begin_.at(0, i)));
  for (size_t sweep = 0; sweep < last; ++sweep)
    for (const State& state : states_[sweep]) numbers += static_cast<double>(components(state.type));
  const double room = std::max(1.0, kKeptNumbers / (trips * numbers));
  const size_t step = last == 0 || room > static_cast<double>(frame_.n) ? frame_.n : static_cast<size_t>(room);
  for (size_t first = 0; first < frame_.n; first += step) {
    std::vector<uint32_t> elements;
    for (size_t i = first; i < std::min(first + step, frame_.n); ++i) {
      if (bound > 0 && begin_.at(0, i) < end_.at(0, i)) elements.push_back(static_cast<uint32_t>(i));
    }
    run_elements(std::move(elements));
  }
  finish();
}

void FoldRun::start_states() {
  size_t operand = 2;
  for (size_t sweep = 0; sweep < states_.size(); ++sweep) {
    for (size_t k = 0; k < ir::fold_states(op_, sweep); ++k) {
      const uint32_t slot = plan_.operands[operand++];
      const Lanes& start = runner_.get(frame_, slot);
      State& state = states_[sweep].emplace_back();
      state.type = frame_.plan->slots[slot].type;
      state.origin = start.origin;
      for (size_t c = 0; c < components(state.type); ++c)
        for (size_t i = 0; i < frame_.n; ++i) state.now.push_back(start.at(c, i));
    }
  }
}

void FoldRun::run_elements(std::vector<uint32_t> elements) {
  for (std::vector<State>& states : states_)
    for (State& state : states) state.before.clear();
  lists_.assign(1, std::move(elements));
  list_of_trip_.clear();
  for (size_t sweep = 0; sweep < states_.size(); ++sweep) run_sweep(sweep);
}

void FoldRun::run_sweep(size_t sweep) {
  Frame body = runner_.inner(plan_.regions[sweep], frame_, nullptr);
  const std::vector<uint32_t>* before = nullptr;
  const auto trip_of = [&](size_t trip) {
    const std::vector<uint32_t>& list = list_of(trip);
    runner_.clear(body, before != nullptr && before->size() == list.size());
    body.from_parent = &lists_[list_of_trip_[trip]];
    body.n = list.size();
    run_trip(sweep, trip, body, list);
    before = &lists_[list_of_trip_[trip]];
  };
  if (sweep == 0) {
    // lists_ grows while it is pointed at: a list that ends stays where it is.
    lists_.reserve(lists_[0].size() + 2);
    for (size_t trip = 0; !lists_.back().empty(); ++trip) {
      list_of_trip_.push_back(lists_.size() - 1);
      trip_of(trip);
    }
  } else if (sweep % 2 == 0) {
    for (size_t trip = 0; trip < list_of_trip_.size(); ++trip) trip_of(trip);
  } else {
    for (size_t trip = list_of_trip_.size(); trip-- > 0;) trip_of(trip);
  }
  runner_.clear(body);
}

void FoldRun::run_trip(size_t sweep, size_t trip, Frame& body, const std::vector<uint32_t>& list) {
  give_states(sweep, trip, body, list);
  runner_.run(body);
  if (sweep == 0) {
    const bool stops = ir::fold_stops(op_);
    const Lanes* stop = stops ? &runner_.get(body, body.plan->yields[0].value) : nullptr;
    const double next = static_cast<double>(trip) + 1;
    std::vector<uint32_t> rest;
    for (size_t j = 0; j < list.size(); ++j) {
      if (stop != nullptr && stop->at(0, j) != 0) continue;
      if (ir::fold_bound(op_) >= 0 && next >= static_cast<double>(ir::fold_bound(op_))) continue;
      if (begin_.at(0, list[j]) + next < end_.at(0, list[j])) rest.push_back(list[j]);
    }
    if (rest.size() < list.size()) lists_.push_back(std::move(rest));
  }
  take_results(sweep, body, list);
}

void FoldRun::give_states(size_t sweep, size_t trip, Frame& body, const std::vector<uint32_t>& list) {
  const size_t n = list.size();
  double* number = runner_.make(body, body.plan->params[0], n);
  for (size_t j = 0; j < n; ++j) number[j] = begin_.at(0, list[j]) + static_cast<double>(trip);
  size_t param = 1;
  for (size_t of = 0; of <= sweep; ++of) {
    for (State& state : states_[of]) {
      const size_t planes = components(state.type);
      const uint32_t slot = body.plan->params[param++];
      double* out = runner_.make(body, slot, n);
      if (of < sweep) {
        std::copy(state.before[trip].begin(), state.before[trip].end(), out);
      } else {
        for (size_t c = 0; c < planes; ++c)
          for (size_t j = 0; j < n; ++j) out[c * n + j] = state.now[c * frame_.n + list[j]];
        if (sweep + 1 < states_.size()) {
          if (state.before.size() <= trip) state.before.resize(trip + 1);
          state.before[trip].assign(out, out + planes * n);
        }
      }
      if (runner_.context_.tracing() && first_not_finite(out, planes, n) < n) body.lanes[slot].origin = state.origin;
    }
  }
}

void FoldRun::take_results(size_t sweep, Frame& body, const std::vector<uint32_t>& list) {
  const bool last = sweep + 1 == states_.size();
  const size_t skip = sweep == 0 && ir::fold_stops(op_) ? 1 : 0, states = states_[sweep].size();
  for (size_t k = 0; k < body.plan->yields.size() - skip; ++k) {
    const YieldPlan& yield = body.plan->yields[skip + k];
    if (yield.how == Yield::Scatter) {
      if (!yield.forwarded) runner_.scatter(body, yield);
      continue;
    }
    DR_ASSERT(k < states || last);
    State& state = k < states ? states_[sweep][k] : sums_[k];
    const Lanes& value = runner_.get(body, yield.value);
    const bool round = state.type.is_float() && runner_.context_.float32;
    for (size_t c = 0; c < components(state.type); ++c) {
      for (size_t j = 0; j < list.size(); ++j) {
        double& out = state.now[c * frame_.n + list[j]];
        if (yield.how == Yield::Element) {
          out = value.at(c, j);
          continue;
        }
        out += value.at(c, j);
        if (round) out = static_cast<double>(static_cast<float>(out));
        if (!state.type.is_float()) out = wrap(out, state.type.scalar);
      }
    }
    if (value.origin.valid() && !state.origin.valid()) state.origin = value.origin;
  }
}

void FoldRun::finish() {
  const std::vector<State>& states = states_.back();
  for (size_t k = 0; k < plan_.results.size(); ++k) {
    if (op_.attrs.yields[k] == Yield::Scatter) continue;
    const State& state = k < states.size() ? states[k] : sums_[k];
    double* out = runner_.make(frame_, plan_.results[k], frame_.n);
    std::copy(state.now.begin(), state.now.end(), out);
    if (!runner_.context_.tracing()) continue;
    const size_t bad = first_not_finite(out, components(state.type), frame_.n);
    if (bad == frame_.n) continue;
    frame_.lanes[plan_.results[k]].origin = state.origin.valid() ? state.origin : runner_.origin_here(frame_, plan_, bad);
  }
}

}  // namespace dr::reference
