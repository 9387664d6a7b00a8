// SPDX-License-Identifier: Apache-2.0
// The progress line.
#include "runtime/drun/progress.h"

#include <unistd.h>

#include <cstdio>
#include <utility>

namespace dr::drun {

Progress::Progress(std::string step, int done, int total)
    : step_(std::move(step)), first_(done), total_(total), visible_(isatty(STDERR_FILENO) != 0 && total - done >= 2) {}

Progress::~Progress() {
  if (visible_) std::fputc('\n', stderr);
}

void Progress::show(int done, const std::string& values) {
  if (!visible_) return;
  constexpr int kCells = 20;
  const std::string bar(static_cast<size_t>(int64_t{kCells} * done / total_), '#');
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
  const double rate = seconds > 0 ? (done - first_) / seconds : 0;
  std::fprintf(stderr, "\r\033[K%s [%-*s] %d/%d  %s  %.1f steps/s  %.0f s left", step_.c_str(), kCells, bar.c_str(),
               done, total_, values.c_str(), rate, rate > 0 ? (total_ - done) / rate : 0.0);
  std::fflush(stderr);
}

LongWork::LongWork(std::string what)
    : thread_([this, what = std::move(what)] {
        std::unique_lock lock(lock_);
        if (!over_.wait_for(lock, std::chrono::seconds(5), [&] { return is_over_; }))
          std::fprintf(stderr, "%s\n", what.c_str());
      }) {}

LongWork::~LongWork() {
  {
    const std::lock_guard guard(lock_);
    is_over_ = true;
  }
  over_.notify_one();
  thread_.join();
}

}  // namespace dr::drun
