// SPDX-License-Identifier: Apache-2.0
// Ranges, lists of (trip, element) pairs, and the folds of what trips yield.
#include "compiler/reference/reduce.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace dr::reference {

using ir::Yield;

ReduceRun::ReduceRun(RegionRunner& runner, Frame& frame, const OpPlan& plan)
    : runner_(runner),
      frame_(frame),
      plan_(plan),
      body_(plan.regions[0]),
      begin_(runner.get(frame, plan.operands[0])),
      end_(runner.get(frame, plan.operands[1])),
      best_(plan.results.size()) {}

void ReduceRun::run() {
  const size_t n = frame_.n;
  for (size_t k = 0; k < plan_.results.size(); ++k) {
    const Yield how = body_.yields[k].how;
    if (how == Yield::Scatter) continue;
    const ir::Type type = frame_.plan->slots[plan_.results[k]].type;
    double* total = runner_.make(frame_, plan_.results[k], n);
    switch (how) {
      case Yield::Sum: std::fill_n(total, components(type) * n, 0.0); break;
      case Yield::Min:
      case Yield::Max: std::fill_n(total, components(type) * n, fold_start(how, type.scalar)); break;
      case Yield::ArgMin:
        for (size_t i = 0; i < n; ++i) total[i] = wrap(begin_.at(0, i) - 1, ir::Scalar::Int);
        best_[k].assign(n, std::numeric_limits<double>::quiet_NaN());
        break;
      case Yield::Element:
      case Yield::Scatter: DR_ICE("a Reduce cannot yield an element");
    }
  }
  if (begin_.n == 1 && end_.n == 1 && 2 * n > kBatch) {
    run_same_range();
  } else {
    run_pairs();
  }
  if (runner_.context_.tracing()) trace();
}

void ReduceRun::run_same_range() {
  Frame body = runner_.inner(body_, frame_, nullptr);
  for (double i = begin_.data[0]; i < end_.data[0]; ++i) {
    *runner_.make(body, body_.params[0], 1) = i;
    runner_.run(body);
    fold(body, nullptr);
    runner_.clear(body, true);
  }
  runner_.clear(body);
}

void ReduceRun::run_pairs() {
  std::vector<uint32_t> alive, list, next;
  for (size_t i = 0; i < frame_.n; ++i) {
    if (begin_.at(0, i) < end_.at(0, i)) alive.push_back(static_cast<uint32_t>(i));
  }
  std::vector<double> trips;
  Frame body = runner_.inner(body_, frame_, &list);
  for (double trip = 0; !alive.empty();) {
    next.clear();
    trips.clear();
    do {
      for (uint32_t i : alive) {
        next.push_back(i);
        trips.push_back(begin_.at(0, i) + trip);
      }
      ++trip;
      std::erase_if(alive, [&](uint32_t i) { return begin_.at(0, i) + trip >= end_.at(0, i); });
    } while (!alive.empty() && next.size() + alive.size() <= kBatch);
    runner_.clear(body, next == list);
    std::swap(list, next);
    body.n = list.size();
    std::copy(trips.begin(), trips.end(), runner_.make(body, body_.params[0], body.n));
    runner_.run(body);
    fold(body, &list);
  }
  runner_.clear(body);
}

void ReduceRun::fold(Frame& body, const std::vector<uint32_t>* list) {
  for (size_t k = 0; k < plan_.results.size(); ++k) {
    const YieldPlan& yield = body_.yields[k];
    if (yield.how == Yield::Scatter) {
      if (!yield.forwarded) runner_.scatter(body, yield);
      continue;
    }
    Lanes& total = frame_.lanes[plan_.results[k]];
    const Lanes& value = runner_.get(body, yield.value);
    fold_one(yield, total, k, value, body.lanes[body_.params[0]], body.n, list);
    if (!total.origin.valid()) total.origin = value.origin;
  }
}

void ReduceRun::fold_one(const YieldPlan& yield, Lanes& total, size_t result, const Lanes& value, const Lanes& trip,
                         size_t n, const std::vector<uint32_t>* list) {
  const ir::Type type = frame_.plan->slots[plan_.results[result]].type;
  const auto each = [&](auto combine) {
    for (size_t c = 0; c < components(type); ++c) {
      double* out = total.own.data() + c * total.n;
      for (size_t j = 0; j < n; ++j) {
        double& sum = out[list != nullptr ? (*list)[j] : j];
        sum = combine(sum, value.at(c, j));
      }
    }
  };
  switch (yield.how) {
    case Yield::Sum:
      if (type.is_float() && runner_.context_.float32) {
        each([](double sum, double x) { return static_cast<double>(static_cast<float>(sum + x)); });
      } else if (type.is_float()) {
        each([](double sum, double x) { return sum + x; });
      } else {
        each([&](double sum, double x) { return wrap(sum + x, type.scalar); });
      }
      break;
    case Yield::Min: each(fold_min); break;
    case Yield::Max: each(fold_max); break;
    case Yield::ArgMin:
      for (size_t j = 0; j < n; ++j) {
        const size_t i = list != nullptr ? (*list)[j] : j;
        const double x = value.at(0, j);
        double& best = best_[result][i];
        if (std::isnan(x) || x >= best) continue;
        best = x;
        total.own.data()[i] = trip.at(0, j);
      }
      break;
    case Yield::Element:
    case Yield::Scatter: break;
  }
}

void ReduceRun::trace() {
  for (size_t k = 0; k < plan_.results.size(); ++k) {
    if (body_.yields[k].how == Yield::Scatter) continue;
    Lanes& total = frame_.lanes[plan_.results[k]];
    const size_t bad = first_not_finite(total.data, components(frame_.plan->slots[plan_.results[k]].type), total.n);
    if (bad == total.n) {
      total.origin = {};
    } else if (!total.origin.valid()) {
      total.origin = runner_.origin_here(frame_, plan_, bad);
    }
  }
}

}  // namespace dr::reference
