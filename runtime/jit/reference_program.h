// SPDX-License-Identifier: Apache-2.0
// The fallback device: a program on the float64 evaluator, behind the same calls as runtime::Program.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "compiler/io/array/array.h"

namespace dr::jit {

class ReferenceProgram {
 public:
  // The bundle's graph text is what runs; its shaders are not looked at.
  // `warn` is as runtime::LoadOptions has it.
  static io::Result<ReferenceProgram> load(std::span<const uint8_t> bundle,
                                           std::function<void(const std::string&)> warn = {});
  ReferenceProgram(ReferenceProgram&&) noexcept;
  ReferenceProgram& operator=(ReferenceProgram&&) noexcept;
  ~ReferenceProgram();

  io::Result<void> bind(const std::string& leaf, const io::Array& data);
  io::Result<void> bind_symbol(const std::string& symbol, int64_t value);
  io::Result<void> run(const std::string& step, int times = 1);
  io::Result<void> set_runs(const std::string& step, int64_t runs);
  io::Result<io::Array> output(const std::string& step, const std::string& name);
  io::Result<io::Array> leaf(const std::string& name);

  // Discrete decisions of another device: for the k-th raster of the step its faces and tags, rank by rank, used by
  // every later run of that step instead of computing them; none: it computes its own again. Later runs say so where
  // rasters or sizes are not those of the step.
  io::Result<void> freeze(const std::string& step, const std::vector<std::vector<io::Array>>& rasters);
  // Later runs round what every op gives to float32, as a device does.
  void round_to_float32(bool rounds);
  // The raster results of the step's last run, in the same form: frozen ones too.
  std::vector<std::vector<io::Array>> rasters(const std::string& step) const;
  // The values that the program pins, as the step's last run had them.
  std::vector<std::pair<std::string, io::Array>> pins(const std::string& step) const;

 private:
  ReferenceProgram();
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace dr::jit
