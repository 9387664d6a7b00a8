// SPDX-License-Identifier: Apache-2.0
// A run that can be watched: a page on this machine's loopback address shows how it goes, and pauses, steps and stops
// it. While nobody looks, a run pays for an atomic load between batches of runs; while somebody does, what is read for
// the page is held to a hundredth of the processor's time.
#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "compiler/io/array/array.h"
#include "compiler/io/file/result.h"
#include "runtime/watch/board.h"

namespace dr::watch {

// How what the run gives is read; called by the run's thread, within Watch's functions.
struct Reader {
  std::function<std::vector<std::string>(const std::string& step)> outputs;
  std::function<io::Result<io::Array>(const std::string& step, const std::string& name)> output;
  std::function<std::vector<Left>(const std::string& step)> left_out;  // may be empty
};

class Watch {
 public:
  // Port 0 is any that is free.
  static io::Result<std::unique_ptr<Watch>> open(int port, Reader reader);
  ~Watch();
  Watch(const Watch&) = delete;
  Watch& operator=(const Watch&) = delete;

  std::string url() const;  // with the token that the page asks for
  bool is_stopped() const { return board_.wish() == Board::Wish::Stop; }
  // Before runs of a step that has run `done` times: how many of the `wanted` ones may run now. 0 while the page holds
  // the run, for as long as `patience`, and when it is stopped.
  int allow(const std::string& step, int64_t done, int wanted, std::chrono::milliseconds patience);
  // Numbers that somebody has read anyway: they go into the curves.
  void add(const std::string& step, const std::string& name, int64_t run, const std::vector<double>& numbers);
  // The last run was made.
  void end(const std::string& step, int64_t done);

 private:
  using Clock = std::chrono::steady_clock;
  explicit Watch(Reader reader) : reader_(std::move(reader)) {}
  void look(const std::string& step, int64_t done);
  void look_if_due(const std::string& step, int64_t done);
  double pace(const std::string& step, int64_t done);

  Reader reader_;
  Board board_;
  std::unique_ptr<LoopbackServer> server_;
  std::set<std::string> large_;  // outputs that are neither numbers nor pictures
  Clock::time_point next_{};     // when the page's values are read again
  double seconds_ = 0;           // that reading them took
  int64_t shown_ = -1;           // the run that they are of
  std::string shown_step_;
  int shown_layer_ = 0;
  std::string paced_step_;
  int64_t paced_ = 0;
  Clock::time_point paced_at_{};
  double runs_per_second_ = 0;
};

}  // namespace dr::watch
