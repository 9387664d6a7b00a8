// SPDX-License-Identifier: Apache-2.0
// The threads of one evaluation. Work is cut into tasks whose number depends on the data alone, and tasks write to
// places of their own, so that no result depends on the number of threads.
#pragma once

#include <atomic>
#include <condition_variable>
#include <cstddef>
#include <exception>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

namespace dr::reference {

class Workers {
 public:
  explicit Workers(int threads);  // 0: as many as the machine has
  ~Workers();
  Workers(const Workers&) = delete;
  Workers& operator=(const Workers&) = delete;

  // Callers may keep one piece of scratch memory a worker.
  size_t count() const { return count_; }

  // Calls job(task, worker) once for each task below `tasks` and returns when all are done, or throws what one threw.
  // Tasks start in order: when one runs, all before it have started. Not to be called from inside a job.
  using Job = std::function<void(size_t task, size_t worker)>;
  void run(size_t tasks, const Job& job);

 private:
  void serve(size_t worker);
  void take_tasks(size_t worker);

  size_t count_;
  std::vector<std::thread> threads_;  // started when first needed
  std::mutex mutex_;
  std::condition_variable wake_, done_;
  uint64_t generation_ = 0;  // counts calls of run()
  size_t busy_ = 0;
  bool stop_ = false;
  std::exception_ptr failure_;  // of a job
  const Job* job_ = nullptr;
  size_t tasks_ = 0;
  std::atomic<size_t> next_ = 0;
};

// Lets tasks pass one after another, in the order of their numbers.
class Turnstile {
 public:
  void wait_for(size_t task);  // until all tasks before it have left
  void leave(size_t task);
  // A task ended without leaving: there was no memory for it, and nobody is to wait for it.
  void give_up();

 private:
  std::mutex mutex_;
  std::condition_variable moved_;
  size_t next_ = 0;
  bool given_up_ = false;
};

}  // namespace dr::reference
