// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/spirv/spare_memory.h"

#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <mutex>
#include <new>

namespace dr::backend {

namespace {

// Never written to, so it is address space alone.
constexpr size_t kBytes = size_t{32} << 20;

std::atomic<void*> spare = nullptr;
std::new_handler other_handler = nullptr;
thread_local int depth = 0;
thread_local bool used = false;

// What operator new calls before it tries once more.
void on_no_memory() {
  if (depth == 0) {
    if (other_handler == nullptr) throw std::bad_alloc();
    other_handler();
    return;
  }
  used = true;
  void* const kept = spare.exchange(nullptr);
  if (kept != nullptr) return std::free(kept);
  std::fputs("error: this machine has not enough memory to compile shaders\n", stderr);
  std::_Exit(1);
}

}  // namespace

SpareMemory::SpareMemory() {
  static std::once_flag once;
  std::call_once(once, [] { other_handler = std::set_new_handler(on_no_memory); });
  if (spare == nullptr) {
    void* const fresh = std::malloc(kBytes);
    if (fresh == nullptr) throw std::bad_alloc();
    void* none = nullptr;
    if (!spare.compare_exchange_strong(none, fresh)) std::free(fresh);
  }
  used = false;
  ++depth;
}

SpareMemory::~SpareMemory() { --depth; }

void SpareMemory::done() {
  if (used) throw std::bad_alloc();
}

}  // namespace dr::backend
