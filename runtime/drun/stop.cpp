// SPDX-License-Identifier: Apache-2.0
#include "runtime/drun/stop.h"

#include <unistd.h>

#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdio>

namespace dr::drun {

namespace {

constexpr int kTimedOut = -1, kWished = -2, kTimeoutCode = 124;
constexpr double kGrace = 5;  // seconds

std::atomic<int> stopped = 0;  // the signal, kTimedOut or kWished
static_assert(std::atomic<int>::is_always_lock_free, "a signal's handler stores it");

void on_signal(int signal) {
  stopped = signal;
  std::signal(signal, SIG_DFL);
}

}  // namespace

void catch_signals() {
  std::signal(SIGINT, on_signal);
  std::signal(SIGTERM, on_signal);
  // Its terminal went away; under nohup it is not to hear of it.
  if (std::signal(SIGHUP, on_signal) == SIG_IGN) std::signal(SIGHUP, SIG_IGN);
}

void stop_as_wished() {
  int running = 0;
  stopped.compare_exchange_strong(running, kWished);
}

bool is_stopping() { return stopped != 0; }

int exit_code_of_stop() {
  const int now = stopped;
  return now == kTimedOut ? kTimeoutCode : now == 0 || now == kWished ? 0 : 128 + now;
}

const char* reason_of_stop() {
  const int now = stopped;
  return now == kTimedOut ? "the time is over"
         : now == kWished ? "stopped on its page"
         : now == SIGTERM ? "terminated"
         : now == SIGHUP  ? "its terminal is gone"
                          : "interrupted";
}

Timeout::Timeout(double seconds) {
  if (seconds > 0) thread_ = std::thread([this, seconds] { wait(seconds); });
}

Timeout::~Timeout() {
  {
    const std::lock_guard guard(lock_);
    is_over_ = true;
  }
  over_.notify_all();
  if (thread_.joinable()) thread_.join();
}

void Timeout::wait(double seconds) {
  std::unique_lock guard(lock_);
  const auto over = [this] { return is_over_; };
  if (over_.wait_for(guard, std::chrono::duration<double>(seconds), over)) return;
  stopped = kTimedOut;
  if (over_.wait_for(guard, std::chrono::duration<double>(kGrace), over)) return;
  std::fprintf(stderr,
               "drun: error: nothing came to an end within %g seconds and %g more: ended by --timeout; a checkpoint in "
               "--out stays, --resume goes on from it\n",
               seconds, kGrace);
  // Whatever still runs on the device cannot be waited for, nor freed under it.
  std::_Exit(kTimeoutCode);
}

}  // namespace dr::drun
