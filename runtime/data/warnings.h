// SPDX-License-Identifier: Apache-2.0
// NaN and Inf in what the host reads, or in what a pass left: somebody is told, once for each of them.
#pragma once

#include <algorithm>
#include <chrono>
#include <functional>
#include <set>
#include <string>

#include "compiler/io/array/array.h"

namespace dr::runtime {

class Warnings {
 public:
  using Warn = std::function<void(const std::string&)>;
  explicit Warnings(Warn warn = {}) : warn_(std::move(warn)) {}
  // Whether there is anybody to tell.
  bool wanted() const { return warn_ != nullptr; }
  // Tells that "`what` has NaN at element (0, 1, 0)" if it does. `what` is as in "output 'fit.error'".
  void look(const std::string& what, const io::Array& read);
  void look(const std::string& what, const io::Scalars& read);
  void once(const std::string& of, const std::string& message);
  // Runs `look`, unless such looks would take more than a hundredth of the time: for what nobody asked to read. What
  // they did not take is saved up, but no more than a millisecond of it, so that many short runs are not all looked at
  // because of a long one before.
  template <class Look>
  void now_and_then(const Look& look) {
    constexpr int kShare = 100;
    constexpr Clock::duration kMost = std::chrono::milliseconds(1);
    const auto begin = Clock::now();
    left_ = std::min(left_ + (begin - looked_) / kShare, kMost);
    looked_ = begin;
    if (!wanted() || left_ <= Clock::duration::zero()) return;
    look();
    looked_ = Clock::now();
    left_ -= looked_ - begin;
  }

 private:
  using Clock = std::chrono::steady_clock;
  Warn warn_;
  std::set<std::string> told_;
  Clock::time_point looked_ = Clock::now();
  Clock::duration left_ = std::chrono::milliseconds(1);  // that looks may take
};

}  // namespace dr::runtime
