// SPDX-License-Identifier: Apache-2.0
// What regions scatter: the results of a region op into which they add, shared by the tasks that evaluate it.
#pragma once

#include <cstdint>
#include <vector>

#include "compiler/reference/batch.h"
#include "compiler/reference/workers.h"

namespace dr::reference {

// Images that Scatter results add into. Additions are logged, and applied when all tasks before have applied theirs, so
// that every sum has one order: by task, in it by trip, in that by element.
struct Scatter {
  std::vector<Image*> images;
  std::vector<Origin> origins;  // by image; of the first value added that is not finite
  Turnstile turnstile;
};

class ScatterLog {
 public:
  ScatterLog(Scatter& scatter, size_t task)
      : scatter_(scatter), task_(task), places_(scatter.images.size()), values_(scatter.images.size()) {}
  // Element i of the lists, which stands at `places`, adds to the image `sink`.
  void add(uint32_t sink, const Lanes& index, ir::Type index_type, const Lanes& value, const Places& places);
  // Applies what is left. To be called once, at the task's end.
  void finish();

 private:
  void apply();

  Scatter& scatter_;
  size_t task_;
  std::vector<std::vector<size_t>> places_;  // by sink: where in the image's planes
  std::vector<std::vector<double>> values_;  // by sink: the components for each place
  size_t logged_ = 0;
};

}  // namespace dr::reference
