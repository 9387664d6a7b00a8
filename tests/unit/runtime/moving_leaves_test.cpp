// SPDX-License-Identifier: Apache-2.0
// Which leaves others change from run to run.
#include "runtime/cache/moving_leaves.h"

#include "tests/catch.h"

using namespace dr;
using runtime::MovingLeaves;
using Leaves = std::vector<uint32_t>;

TEST_CASE("leaves that others change before each run move; the step's own changes do not count") {
  MovingLeaves moving({0, 2, 3});
  std::vector<uint64_t> versions{1, 1, 1, 1};
  const auto run = [&] {
    moving.begin_run(versions);
    ++versions[3];  // the step's own
    moving.end_run(versions);
    return moving.moving();
  };
  CHECK(run() == Leaves{});
  CHECK(moving.runs() == 0);  // there is nothing to compare with
  for (int k = 1; k <= 3; ++k) {
    ++versions[2];
    ++versions[1];  // not of this step
    CHECK(run() == Leaves{2});
    CHECK(moving.runs() == k);
  }
  ++versions[0];
  ++versions[2];
  CHECK(run() == Leaves{0, 2});
  CHECK(moving.runs() == 1);
  CHECK(run() == Leaves{});
  CHECK(run() == Leaves{});
  CHECK(moving.runs() == 2);
  ++versions[3];
  CHECK(run() == Leaves{3});
}
