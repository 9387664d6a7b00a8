// SPDX-License-Identifier: Apache-2.0
// Lavapipe compiles a shader when it is dispatched for the first time, one after the other. Where it has not seen them
// before, that is most of a first run. A second device compiles a step's shaders meanwhile, the last one first, by
// dispatches of no workgroup. The driver keeps what it compiled in files, where the run finds it.
//   the run       a b c d e f g h
//   beside it     h g f e              then all are there
// Behind them it compiles those of the steps that come next, whose first runs then find them.
#pragma once

#include <atomic>
#include <condition_variable>
#include <mutex>
#include <optional>
#include <set>
#include <thread>
#include <vector>

#include "runtime/program/state.h"

namespace dr::runtime {

class CompileBeside {
 public:
  struct Step {
    size_t index;
    std::set<uint32_t> resources;  // that its commands use
  };
  // Steps in the order in which they will run; symbols of the first one have values. Nothing here fails: a step runs as
  // well without.
  CompileBeside(const DeviceState& device, const bundle::BundleT& bundle, const Sizes& sizes,
                const LoadOptions& options, std::vector<Step> steps);
  // Waits for the shader that is being compiled, and leaves out the rest.
  ~CompileBeside();
  // Until all are compiled.
  void wait();
  bool has(size_t step) const;
  // The run comes to a step: its first shader is the run's, unless it is being compiled, which this waits for.
  void arrive(size_t step);
  // Whether it gains anything: by this driver, where it keeps files, on more than one core.
  static bool is_worth_it(const DeviceState& device);

 private:
  void compile();
  // Whether a shader is to be compiled here; it is the one in work then.
  bool take(size_t step, bool is_first);
  void give_back();
  bundle::BundleT bundle_;
  Sizes sizes_;
  LoadOptions options_;
  std::string device_;
  const std::vector<Step> steps_;
  std::atomic<bool> stop_ = false;
  std::mutex lock_;
  std::condition_variable changed_;
  size_t arrived_;                       // the step that runs
  std::optional<size_t> first_in_work_;  // the step whose first shader is being compiled
  std::thread thread_;
};

}  // namespace dr::runtime
