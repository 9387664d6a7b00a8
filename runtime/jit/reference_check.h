// SPDX-License-Identifier: Apache-2.0
// A run of a step on a device, compared with the same run on the float64 evaluator.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "compiler/io/array/array.h"
#include "runtime/runtime.h"

namespace dr::jit {

// A value that differs, and the worst of its elements.
struct Difference {
  std::string value, pass;  // an output, leaf or raster, and the command that wrote it last
  std::vector<std::string> lines;
  io::Place place;  // what the device has there
  double expected = 0;
  int64_t count = 0, size = 0;  // of numbers: those that differ, and all
  double share = 0;             // how far the worst is off, of the larger of its magnitude and its value's
};

struct Comparison {
  int values = 0;                  // compared
  std::vector<Difference> differ;  // in the order in which commands wrote them
  // Values that pass although some numbers are far off, since float32 alone makes as much of them.
  std::vector<Difference> excused;
};

class ReferenceCheck {
 public:
  static io::Result<ReferenceCheck> load(std::span<const uint8_t> bundle);
  io::Result<void> bind_symbol(const std::string& symbol, int64_t value);

  // Runs the step once on both, from what the device's leaves hold; `runs` is how often it has run. Compared are its
  // outputs, the leaves that it changes, and faces and tags of its rasters. A raster may choose otherwise for a few
  // pixels, whose centres lie on an edge: the evaluator then takes over the device's choices.
  io::Result<Comparison> run(runtime::Program& program, const std::string& step, int64_t runs);

  ReferenceCheck(ReferenceCheck&&) noexcept;
  ReferenceCheck& operator=(ReferenceCheck&&) noexcept;
  ~ReferenceCheck();

 private:
  struct State;
  explicit ReferenceCheck(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

// "pass 'y' gives 3 for 'y' at element (1, 0, 0), the reference 2, ...; lines p.dr:3"
std::string describe(const Difference& difference);

}  // namespace dr::jit
