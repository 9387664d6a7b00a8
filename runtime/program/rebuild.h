// SPDX-License-Identifier: Apache-2.0
// Building a program anew for the leaves that move, beside its runs. Private to the runtime.
#pragma once

#include <atomic>
#include <memory>
#include <set>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "compiler/backend/bundle/bundle.h"
#include "runtime/cache/moving_leaves.h"
#include "runtime/runtime.h"

namespace dr::runtime {

class Rebuilder {
 public:
  // Of a program that was built for these.
  explicit Rebuilder(Moving built_for = {}) : built_for_(std::move(built_for)) {}
  // Waits for what is being built.
  ~Rebuilder();
  // After a run of the step: starts to build, if that may help. `program` is looked at before this returns.
  void watch(const Program::State& program, size_t step, const MovingLeaves& moving);
  // Whether there is something to take: the program with its pipelines, but without contents.
  bool ready() const { return ready_; }
  std::unique_ptr<Program::State> take();
  // Whether the user finds the same leaves, steps and outputs in both.
  static bool same_names(const bundle::BundleT& a, const bundle::BundleT& b);

 private:
  Moving built_for_;
  std::set<std::pair<size_t, std::set<std::string>>> tried_;  // steps, and what moves there
  std::unique_ptr<Program::State> built_;
  std::atomic<bool> busy_ = false, ready_ = false;
  std::jthread thread_;  // destroyed first: it uses the others
};

}  // namespace dr::runtime
