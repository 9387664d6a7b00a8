// SPDX-License-Identifier: Apache-2.0
// The log of what a task scatters, and its turn to apply it.
#include "compiler/reference/scatter.h"

#include <cmath>

namespace dr::reference {
namespace {

// Additions after which a task waits for its turn rather than log on.
constexpr size_t kLogLimit = size_t{1} << 20;

}  // namespace

void ScatterLog::add(uint32_t sink, const Lanes& index, ir::Type index_type, const Lanes& value, const Places& places) {
  const Image& image = *scatter_.images[sink];
  const Size size = size_of(image);
  const size_t planes = components(image.type), index_planes = components(index_type);
  bool all_finite = true;
  for (size_t i = 0; i < places.size(); ++i) {
    const double* here = index.data + (index.n == 1 ? 0 : i);
    const int64_t at = place_of_index(size, index_planes, here, index.n, places.l[i]);
    if (at < 0) continue;
    places_[sink].push_back(static_cast<size_t>(at));
    for (size_t c = 0; c < planes; ++c) {
      values_[sink].push_back(value.at(c, i));
      all_finite &= std::isfinite(value.at(c, i));
    }
  }
  if (!all_finite && value.origin.valid()) {
    // Which origin is reported depends on the order of tasks, as sums do, and not on their timing.
    scatter_.turnstile.wait_for(task_);
    if (!scatter_.origins[sink].valid()) scatter_.origins[sink] = value.origin;
  }
  logged_ += places.size();
  if (logged_ < kLogLimit) return;
  scatter_.turnstile.wait_for(task_);
  apply();
}

void ScatterLog::apply() {
  for (size_t sink = 0; sink < places_.size(); ++sink) {
    Image& image = *scatter_.images[sink];
    const size_t count = size_of(image).count(), planes = components(image.type);
    for (size_t k = 0; k < places_[sink].size(); ++k) {
      for (size_t c = 0; c < planes; ++c) {
        double& sum = image.data[c * count + places_[sink][k]];
        sum = wrap(sum + values_[sink][k * planes + c], image.type.scalar);
      }
    }
    places_[sink].clear();
    values_[sink].clear();
  }
  logged_ = 0;
}

void ScatterLog::finish() {
  if (places_.empty()) return;
  scatter_.turnstile.wait_for(task_);
  apply();
  scatter_.turnstile.leave(task_);
}

}  // namespace dr::reference
