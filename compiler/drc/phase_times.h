// SPDX-License-Identifier: Apache-2.0
// Where the time of a command goes: one phase after the other, from the start of the process on, so that no time is
// without a name.
#pragma once

#include <chrono>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace dr::drc {

class PhaseTimes {
 public:
  // Milliseconds since the last call, or since the process began.
  double lap();
  void add(std::string_view phase, double milliseconds);
  // All since the last lap is the phase's.
  void end(std::string_view phase) { add(phase, lap()); }
  // What a phase took, which is then without a name.
  double take(std::string_view phase);
  // One line a phase, in the order in which they first ended, and their sum.
  std::string text() const;

 private:
  std::chrono::steady_clock::time_point last_{};
  std::vector<std::pair<std::string, double>> phases_;
};

}  // namespace dr::drc
