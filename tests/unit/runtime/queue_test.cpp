// SPDX-License-Identifier: Apache-2.0
// How long a host that waits asks before it sleeps.
#include "runtime/vk/queue.h"

#include "tests/catch.h"

using dr::runtime::Pace;
using dr::runtime::Queue;
using namespace std::chrono_literals;

namespace {

std::chrono::nanoseconds asking(Pace pace, int runs) { return Queue::worth_asking(&pace, runs); }

}  // namespace

TEST_CASE("short runs and copies are asked for beyond their time and the way there and back, other runs never") {
  CHECK(asking({25us}, 1) >= 50us + 50us);
  CHECK(asking({25us}, 32) >= 2 * 32 * 25us);
  CHECK(asking({900us}, 1) <= 2ms);
  CHECK(asking({1ms}, 1) == 0ns);
  CHECK(asking({}, 32) == 0ns);
  CHECK(Queue::worth_asking(nullptr, 1) >= 50us);
}
