// SPDX-License-Identifier: Apache-2.0
#include "runtime/watch/curves.h"

namespace dr::watch {

void Curve::add(int64_t run, double value) {
  if (count_ > 0 && last_.run == run) return;
  last_ = {run, value};
  if (count_++ % every_ != 0) return;
  if (kept_.size() == kMostPoints) {
    for (size_t i = 0; i < kMostPoints / 2; ++i) kept_[i] = kept_[2 * i];
    kept_.resize(kMostPoints / 2);
    every_ *= 2;
    if ((count_ - 1) % every_ != 0) return;
  }
  kept_.push_back(last_);
}

std::vector<Curve::Point> Curve::points() const {
  std::vector<Point> out = kept_;
  if (count_ > 0 && (out.empty() || out.back().run != last_.run)) out.push_back(last_);
  return out;
}

}  // namespace dr::watch
