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
  std::atomic<long> seen = 0, at = 0;
};
std::array<Order, kKinds> orders;
std::atomic<const char*> what_failed = nullptr;

// Nothing here allocates by the calls that it counts: it may stand in any of them.
struct Report {
  Report() {
    const char* order = std::getenv("DR_FAULT");
    for (int k = 0; order != nullptr && k < kKinds; ++k) {
      const size_t length = std::strlen(kNames[k]);
      if (std::strncmp(order, kNames[k], length) == 0 && order[length] == ':')
        orders[static_cast<size_t>(k)].at = std::atol(order + length + 1);
    }
  }
  ~Report() {
    const char* path = std::getenv("DR_FAULT_REPORT");
    if (path == nullptr) return;
    std::string text;
    for (int k = 0; k < kKinds; ++k)
      text += std::string(kNames[k]) + " " + std::to_string(orders[static_cast<size_t>(k)].seen.load()) + "\n";
    text += "failed " + failed() + "\nalive " + alive() + "\n";
    const long file = syscall(SYS_openat, AT_FDCWD, path, O_WRONLY | O_CREAT | O_TRUNC, 0644);
    if (file >= 0) (void)syscall(SYS_write, file, text.data(), text.size());
  }
} report;

}  // namespace

void arm(Kind kind, long at) {
  for (Order& order : orders) order.seen = order.at = 0;
  what_failed = nullptr;
  orders[static_cast<size_t>(kind)].at = at;
}

long seen(Kind kind) { return orders[static_cast<size_t>(kind)].seen; }

std::string failed() {
  const char* name = what_failed;
  return name == nullptr ? "" : name;
}

bool is_due(Kind kind, const char* name, bool (*may_fail)()) {
  Order& order = orders[static_cast<size_t>(kind)];
  const long number = ++order.seen;
  long at = order.at;
  if (at == 0 || number < at || (may_fail != nullptr && !may_fail())) return false;
  if (!order.at.compare_exchange_strong(at, 0)) return false;  // another thread's
  what_failed = name;
  return true;
}

}  // namespace dr::faults
