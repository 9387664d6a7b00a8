// SPDX-License-Identifier: Apache-2.0
// How long a host that waits asks before it sleeps.
#include "runtime/vk/queue.h"

#include "tests/catch.h"

using dr::runtime::Pace;
using dr::runtime::Queue;
using namespace std::chrono_literals;

TEST_CASE("short runs are asked for beyond their time and the way there and back, long ones and unknown ones never") {
  CHECK(Queue::worth_asking({25us}, 1) >= 50us + 50us);
  CHECK(Queue::worth_asking({25us}, 32) >= 2 * 32 * 25us);
  CHECK(Queue::worth_asking({900us}, 1) <= 2ms);
  CHECK(Queue::worth_asking({1ms}, 1) == 0ns);
  CHECK(Queue::worth_asking({}, 32) == 0ns);
}
