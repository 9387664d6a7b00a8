// SPDX-License-Identifier: Apache-2.0
// Reduce inside a frame. Trips are independent of each other but for the fold, so short lists take several trips at
// once: the body's list holds (trip, element) pairs, trip by trip, and the fold goes through it in order.
#pragma once

#include <vector>

#include "compiler/reference/region.h"

namespace dr::reference {

class ReduceRun {
 public:
  ReduceRun(RegionRunner& runner, Frame& frame, const OpPlan& plan);
  void run();

 private:
  void run_same_range();  // all elements have the same range and are many: one trip at a time
  void run_pairs();
  void fold(Frame& body, const std::vector<uint32_t>* list);
  void fold_one(const YieldPlan& yield, Lanes& total, size_t result, const Lanes& value, const Lanes& trip, size_t n,
                const std::vector<uint32_t>* list);
  void trace();

  RegionRunner& runner_;
  Frame& frame_;
  const OpPlan& plan_;
  const Plan& body_;
  const Lanes& begin_;
  const Lanes& end_;
  std::vector<std::vector<double>> best_;  // by result, of ArgMin: the smallest so far, NaN when there is none
};

}  // namespace dr::reference
