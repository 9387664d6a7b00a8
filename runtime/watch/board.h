// SPDX-License-Identifier: Apache-2.0
// What the page shows and what its buttons want: the run's thread writes the one and reads the other, the server's
// thread does the reverse.
#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <map>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "runtime/watch/curves.h"
#include "runtime/watch/http.h"
#include "runtime/watch/picture.h"

namespace dr::watch {

// Of work of one kind, what was done and what was left out.
struct Left {
  std::string what;
  int64_t done = 0, left_out = 0;
};

// What a look at a step that has run `done` times found.
struct Look {
  std::string step;
  int64_t done = 0;
  double runs_per_second = 0;
  std::vector<std::pair<std::string, double>> numbers = {};
  std::vector<std::pair<std::string, Picture>> pictures = {};
  std::vector<Left> left_out = {};
};

class Board {
 public:
  Board();
  const std::string& token() const { return token_; }
  Response answer(const Request& request);  // by the server's thread

  // By the run's thread.
  enum class Wish : uint8_t { Run, Pause, Step, Stop };
  Wish wish() const { return wish_; }
  Wish wait(std::chrono::milliseconds patience);  // until it is not Pause, or so long
  void stepped();                                 // a wished step was made: pause again, unless there are more
  bool is_watched() const;
  int layer() const { return layer_; }
  // Numbers of a step that has run `done` times, for their curves.
  void add(const std::string& step, int64_t done, const std::vector<std::pair<std::string, double>>& numbers);
  void show(Look look);
  void end();  // the run is over: waits a moment, so that a page that looks sees how it ended
  // Seconds of processor time that answering took so far.
  double seconds() const { return seconds_; }
  void set_pause_between_looks(int milliseconds) { poll_ = milliseconds; }

 private:
  Response state_of_run();
  void count(const std::string& step, int64_t done, const std::vector<std::pair<std::string, double>>& numbers);
  Response act(const Request& request);
  bool is_allowed(const Request& request) const;

  std::string token_;
  std::atomic<Wish> wish_ = Wish::Run;
  std::atomic<int> layer_ = 0, poll_ = 500;
  std::atomic<double> seconds_ = 0;
  std::atomic<int64_t> last_look_ = -1'000'000;  // milliseconds of the steady clock
  std::mutex mutex_;                             // of what follows
  std::condition_variable changed_;
  int steps_ = 0;  // that are wished for, while wish_ is Step
  std::map<std::string, Curve> curves_;
  std::map<std::string, std::pair<Picture, int>> pictures_;  // and their numbers
  std::string step_;
  int64_t done_ = 0;
  double runs_per_second_ = 0;
  std::vector<Left> left_;
  bool is_over_ = false, saw_end_ = false;
  int numbers_ = 0;
};

}  // namespace dr::watch
