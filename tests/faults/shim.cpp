// SPDX-License-Identifier: Apache-2.0
// The orders. A program that is not a test of its own takes them from the environment: DR_FAULT=vulkan:17 (or new,
// file, short), and DR_FAULT_REPORT names a file that is told at its end how many calls there were, what failed, and
// what was left alive.
#include "tests/faults/shim.h"

#include <fcntl.h>
#include <sys/syscall.h>
#include <unistd.h>
#include <unwind.h>

#include <array>
#include <atomic>
#include <cstdlib>
#include <cstring>

namespace dr::faults {

namespace {

constexpr const char* kNames[kKinds] = {"vulkan", "new", "file", "short"};

struct Order {
  std::atomic<long> seen = 0, last = 0, at = 0;
  std::atomic<bool> counts = true;  // nothing shall fail: what may is looked for
};
std::array<Order, kKinds> orders;

// The stacks from which calls came while they were counted, as hashes, and the number of the first call from each.
// Where as many as half of the places were taken, others are no news.
struct Stacks {
  static constexpr size_t kMost = 1 << 20;
  std::array<std::atomic<uint64_t>, kMost> seen;
  std::array<long, kMost / 2> first;
  std::atomic<size_t> count;

  // Whether it is the first time.
  bool add(uint64_t hash) {
    for (size_t at = hash % kMost;; at = (at + 1) % kMost) {
      uint64_t free = 0;
      if (seen[at].compare_exchange_strong(free, hash)) return true;
      if (free == hash) return false;
    }
  }
};
Stacks stacks;

// Of all callers up to main(); how often a function called itself makes no difference.
uint64_t hash_of_stack() {
  struct Walk {
    uint64_t hash = 14695981039346656037u;
    std::array<uintptr_t, 8> last = {};
    size_t depth = 0;
  } walk;
  const auto look = [](_Unwind_Context* context, void* to) {
    auto& w = *static_cast<Walk*>(to);
    const uintptr_t at = _Unwind_GetIP(context);
    for (const uintptr_t before : w.last)
      if (before == at) return _URC_NO_REASON;
    w.last[w.depth++ % w.last.size()] = at;
    w.hash = (w.hash ^ at) * 1099511628211u;
    return _URC_NO_REASON;
  };
  _Unwind_Backtrace(look, &walk);
  return walk.hash | 1;
}
std::atomic<const char*> what_failed = nullptr;
std::atomic<bool> is_watching = true;
std::atomic<int> stacks_of = -1;  // the kind of which they are wanted

void set(size_t kind, long at) {
  for (size_t k = 0; k < kKinds; ++k) {
    orders[k].seen = orders[k].last = 0;
    orders[k].at = k == kind ? at : 0;
    orders[k].counts = at == 0;
  }
}

// Nothing here allocates by the calls that it counts: it may stand in any of them.
struct Report {
  Report() {
    const char* order = std::getenv("DR_FAULT");
    for (int k = 0; order != nullptr && k < kKinds; ++k) {
      const size_t length = std::strlen(kNames[k]);
      if (std::strncmp(order, kNames[k], length) == 0 && order[length] == ':')
        set(static_cast<size_t>(k), std::atol(order + length + 1));
    }
  }
  ~Report() {
    const char* path = std::getenv("DR_FAULT_REPORT");
    if (path == nullptr) return;
    std::string text;
    for (int k = 0; k < kKinds; ++k)
      text += std::string(kNames[k]) + " " + std::to_string(seen(static_cast<Kind>(k))) + "\n";
    text += "failed " + failed() + "\nalive " + alive() + "\n";
    const long file = syscall(SYS_openat, AT_FDCWD, path, O_WRONLY | O_CREAT | O_TRUNC, 0644);
    if (file >= 0) (void)syscall(SYS_write, file, text.data(), text.size());
  }
} report;

}  // namespace

void arm(Kind kind, long at) {
  what_failed = nullptr;
  set(static_cast<size_t>(kind), at);
}

void set_watching(bool watching) { is_watching = watching; }

void watch_stacks(Kind kind) {
  for (auto& hash : stacks.seen) hash = 0;
  stacks.count = 0;
  stacks_of = static_cast<int>(kind);
  arm(kind, 0);
}

std::vector<long> first_of_stacks() {
  stacks_of = -1;
  return {stacks.first.begin(), stacks.first.begin() + static_cast<std::ptrdiff_t>(stacks.count.load())};
}

long seen(Kind kind) {
  const Order& order = orders[static_cast<size_t>(kind)];
  return order.counts ? order.last : order.seen;
}

std::string failed() {
  const char* name = what_failed;
  return name == nullptr ? "" : name;
}

bool is_due(Kind kind, const char* name, bool (*may_fail)()) {
  if (!is_watching) return false;
  Order& order = orders[static_cast<size_t>(kind)];
  const long number = ++order.seen;
  if (order.counts) {
    long last = order.last;
    if (may_fail != nullptr && !may_fail()) return false;
    while (last < number && !order.last.compare_exchange_weak(last, number)) {
    }
    if (stacks_of == static_cast<int>(kind) && stacks.count < stacks.first.size() && stacks.add(hash_of_stack()))
      stacks.first[stacks.count++] = number;
    return false;
  }
  long at = order.at;
  if (at == 0 || number < at || (may_fail != nullptr && !may_fail())) return false;
  if (!order.at.compare_exchange_strong(at, 0)) return false;  // another thread's
  what_failed = name;
  return true;
}

}  // namespace dr::faults
