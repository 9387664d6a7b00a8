// SPDX-License-Identifier: Apache-2.0
// How far a step is: one line on stderr that is rewritten, for a person who watches.
#pragma once

#include <chrono>
#include <string>

namespace dr::drun {

class Progress {
 public:
  // Runs from `done` to `total`. Silent when stderr is no terminal, and for a single run.
  Progress(std::string step, int done, int total);
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;
  // `values`: losses and the like, as text.
  void show(int done, const std::string& values);

 private:
  std::string step_;
  int first_, total_;
  bool visible_;
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

}  // namespace dr::drun
