// SPDX-License-Identifier: Apache-2.0
#include "compiler/drc/phase_times.h"

#include <algorithm>
#include <cstdio>

namespace dr::drc {

namespace {

const std::chrono::steady_clock::time_point kStart = std::chrono::steady_clock::now();

}  // namespace

double PhaseTimes::lap() {
  if (phases_.empty() && last_ == std::chrono::steady_clock::time_point{}) last_ = kStart;
  const auto now = std::chrono::steady_clock::now();
  return std::chrono::duration<double, std::milli>(now - std::exchange(last_, now)).count();
}

void PhaseTimes::add(std::string_view phase, double milliseconds) {
  const auto found = std::ranges::find(phases_, phase, &std::pair<std::string, double>::first);
  if (found != phases_.end())
    found->second += milliseconds;
  else
    phases_.emplace_back(phase, milliseconds);
}

double PhaseTimes::take(std::string_view phase) {
  const auto found = std::ranges::find(phases_, phase, &std::pair<std::string, double>::first);
  if (found == phases_.end()) return 0;
  const double milliseconds = found->second;
  phases_.erase(found);
  return milliseconds;
}

std::string PhaseTimes::text() const {
  std::string out;
  double sum = 0;
  const auto line = [&](const std::string& name, double milliseconds) {
    char number[32];
    std::snprintf(number, sizeof number, ": %.3f ms\n", milliseconds);
    out += name + number;
  };
  for (const auto& [name, milliseconds] : phases_) {
    line(name, milliseconds);
    sum += milliseconds;
  }
  line("total", sum);
  return out;
}

}  // namespace dr::drc
