// SPDX-License-Identifier: Apache-2.0
// Independent tasks on all cores, for compiler and runtime alike.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <exception>
#include <mutex>
#include <new>
#include <system_error>
#include <thread>
#include <vector>

namespace dr::bundle {

// work(k) for each k below `count`, each once, in any order. Where one throws, no other begins, and it is thrown on
// when those under way are over.
template <class F>
void on_all_cores(size_t count, const F& work) {
  std::atomic<size_t> next = 0;
  std::mutex lock;
  std::exception_ptr failure;
  const auto go = [&] {
    for (size_t k = next++; k < count; k = next++) try {
        work(k);
      } catch (...) {
        const std::lock_guard guard(lock);
        failure = std::current_exception();
        next = count;
      }
  };
  {
    const size_t cores = std::max(1u, std::thread::hardware_concurrency());
    std::vector<std::jthread> others;  // waited for at the end of this block
    // Where the system gives no more threads, those that there are do it all.
    try {
      for (size_t t = 1; t < std::min(cores, count); ++t) others.emplace_back(go);
    } catch (const std::system_error&) {
    } catch (const std::bad_alloc&) {
    }
    go();
  }
  if (failure) std::rethrow_exception(failure);
}

}  // namespace dr::bundle
