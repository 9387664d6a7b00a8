// SPDX-License-Identifier: Apache-2.0
// The orders. A program that is not a test of its own takes them from the environment: DR_FAULT=vulkan:17 (or new,
// file, short), and DR_FAULT_REPORT names a file that is told at its end how many calls there were, what failed, and
// what was left alive.
#include "tests/faults/shim.h"

#include <fcntl.h>
#include <sys/syscall.h>
#include <unistd.h>

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
std::atomic<const char*> what_failed = nullptr;

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

long seen(Kind kind) {
  const Order& order = orders[static_cast<size_t>(kind)];
  return order.counts ? order.last : order.seen;
}

std::string failed() {
  const char* name = what_failed;
  return name == nullptr ? "" : name;
}

bool is_due(Kind kind, const char* name, bool (*may_fail)()) {
  Order& order = orders[static_cast<size_t>(kind)];
  const long number = ++order.seen;
  if (order.counts) {
    long last = order.last;
    if (may_fail == nullptr || may_fail())
      while (last < number && !order.last.compare_exchange_weak(last, number)) {
      }
    return false;
  }
  long at = order.at;
  if (at == 0 || number < at || (may_fail != nullptr && !may_fail())) return false;
  if (!order.at.compare_exchange_strong(at, 0)) return false;  // another thread's
  what_failed = name;
  return true;
}

}  // namespace dr::faults
