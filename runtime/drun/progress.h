// SPDX-License-Identifier: Apache-2.0
// How far a step is: one line on stderr that is rewritten, for a person who watches.
#pragma once

#include <chrono>
#include <condition_variable>
#include <mutex>
#include <string>
#include <thread>

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

// Says on stderr, once, what is under way, if that takes more than five seconds.
class LongWork {
 public:
  explicit LongWork(std::string what);
  ~LongWork();
  LongWork(const LongWork&) = delete;
  LongWork& operator=(const LongWork&) = delete;

 private:
  std::mutex lock_;
  std::condition_variable over_;
  bool is_over_ = false;
  std::thread thread_;
};

}  // namespace dr::drun
