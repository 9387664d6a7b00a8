// SPDX-License-Identifier: Apache-2.0
// What ends a run before its time: Ctrl-C, SIGTERM, SIGHUP, --timeout, the page of --watch.
#pragma once

#include <condition_variable>
#include <mutex>
#include <thread>

namespace dr::drun {

// From now on Ctrl-C, SIGTERM and SIGHUP let the step that runs finish, and what there is be written; a second one ends
// the program.
void catch_signals();
// As Ctrl-C, but as a wish of the user's that is no failure: the exit code is 0.
void stop_as_wished();

// Whether the run is to end. The exit code then: 128 and the signal, or 124 as timeout(1) has it; 0 while it goes on.
bool is_stopping();
int exit_code_of_stop();
// "interrupted" and the like.
const char* reason_of_stop();

// After so many seconds is_stopping(). Where nothing comes to an end by then, since a device does not return, it ends
// the program some seconds later.
class Timeout {
 public:
  explicit Timeout(double seconds);  // 0: none
  ~Timeout();
  Timeout(const Timeout&) = delete;
  Timeout& operator=(const Timeout&) = delete;

 private:
  void wait(double seconds);
  std::mutex lock_;
  std::condition_variable over_;
  bool is_over_ = false;
  std::thread thread_;
};

}  // namespace dr::drun
