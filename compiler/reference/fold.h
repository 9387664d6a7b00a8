// SPDX-License-Identifier: Apache-2.0
// Fold inside a frame. Elements go through their trips side by side, and leave the list when theirs end. The states of
// all trips that a later sweep sees are kept, for as many elements at a time as memory is meant for.
#pragma once

#include <vector>

#include "compiler/reference/region.h"

namespace dr::reference {

class FoldRun {
 public:
  FoldRun(RegionRunner& runner, Frame& frame, const OpPlan& plan);
  void run();

 private:
  // One state of a sweep over all elements of the frame, as planes.
  struct State {
    ir::Type type;
    std::vector<double> now;
    Origin origin;
    std::vector<std::vector<double>> before;  // by trip, for the elements that run it
  };

  void run_elements(std::vector<uint32_t> elements);
  void start_states();
  void run_sweep(size_t sweep);
  // Runs a trip for `list`; gives which of its elements have no trip after it.
  void run_trip(size_t sweep, size_t trip, Frame& body, const std::vector<uint32_t>& list);
  void give_states(size_t sweep, size_t trip, Frame& body, const std::vector<uint32_t>& list);
  void take_results(size_t sweep, Frame& body, const std::vector<uint32_t>& list);
  const std::vector<uint32_t>& list_of(size_t trip) const { return lists_[list_of_trip_[trip]]; }
  void finish();

  RegionRunner& runner_;
  Frame& frame_;
  const OpPlan& plan_;
  const ir::Op& op_;
  const Lanes& begin_;
  const Lanes& end_;
  std::vector<std::vector<State>> states_;  // by sweep
  std::vector<State> sums_;                 // by result, of Sums
  std::vector<std::vector<uint32_t>> lists_;
  std::vector<size_t> list_of_trip_;
};

}  // namespace dr::reference
