// SPDX-License-Identifier: Apache-2.0
// A small thread pool; the caller of run() is its worker 0.
#include "compiler/reference/workers.h"

#include <algorithm>
#include <new>
#include <system_error>
#include <utility>

namespace dr::reference {

Workers::Workers(int threads)
    : count_(threads > 0 ? static_cast<size_t>(threads) : std::max<size_t>(1, std::thread::hardware_concurrency())) {}

Workers::~Workers() {
  {
    const std::lock_guard lock(mutex_);
    stop_ = true;
  }
  wake_.notify_all();
  for (std::thread& thread : threads_) thread.join();
}

void Workers::take_tasks(size_t worker) {
  for (size_t task = next_++; task < tasks_; task = next_++) try {
      (*job_)(task, worker);
    } catch (...) {
      // The first one is why; those after it may follow from it.
      const std::lock_guard lock(mutex_);
      if (!failure_) failure_ = std::current_exception();
    }
}

void Workers::serve(size_t worker) {
  uint64_t seen = 0;
  std::unique_lock lock(mutex_);
  while (true) {
    wake_.wait(lock, [&] { return stop_ || generation_ != seen; });
    if (stop_) return;
    seen = generation_;
    lock.unlock();
    take_tasks(worker);
    lock.lock();
    if (--busy_ == 0) done_.notify_all();
  }
}

void Workers::run(size_t tasks, const Job& job) {
  if (tasks <= 1 || count_ == 1) {
    for (size_t task = 0; task < tasks; ++task) job(task, 0);
    return;
  }
  // A new thread starts with `seen` = 0 and so finds the work below. Where the system gives no more threads, those that
  // there are do it all.
  try {
    while (threads_.size() + 1 < count_) threads_.emplace_back([this, worker = threads_.size() + 1] { serve(worker); });
  } catch (const std::system_error&) {
    count_ = threads_.size() + 1;
  }
  {
    const std::lock_guard lock(mutex_);
    job_ = &job;
    tasks_ = tasks;
    next_ = 0;
    busy_ = count_ - 1;
    ++generation_;
  }
  wake_.notify_all();
  take_tasks(0);
  std::unique_lock lock(mutex_);
  done_.wait(lock, [&] { return busy_ == 0; });
  if (failure_) std::rethrow_exception(std::exchange(failure_, nullptr));
}

void Turnstile::wait_for(size_t task) {
  std::unique_lock lock(mutex_);
  moved_.wait(lock, [&] { return next_ == task || given_up_; });
  if (given_up_) throw std::bad_alloc();
}

void Turnstile::give_up() {
  {
    const std::lock_guard lock(mutex_);
    given_up_ = true;
  }
  moved_.notify_all();
}

void Turnstile::leave(size_t task) {
  wait_for(task);
  {
    const std::lock_guard lock(mutex_);
    ++next_;
  }
  moved_.notify_all();
}

}  // namespace dr::reference
