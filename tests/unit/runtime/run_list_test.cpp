// SPDX-License-Identifier: Apache-2.0
// Which commands must run, from the versions of leaves.
#include "runtime/cache/run_list.h"

#include "tests/catch.h"

using namespace dr;
using runtime::RunList;

namespace {

using Flags = std::vector<bool>;

bundle::StepT step(const std::vector<std::pair<bool, std::vector<uint32_t>>>& commands) {
  bundle::StepT out;
  for (const auto& [steady, leaves] : commands) {
    out.commands.push_back(std::make_unique<bundle::CommandT>());
    out.commands.back()->steady = steady;
    out.commands.back()->leaves = leaves;
  }
  return out;
}

}  // namespace

TEST_CASE("a command runs again when a leaf that it depends on has another version") {
  // Two of leaf 0, one of 0 and 1, one of none, a steady one of all, a steady one of none.
  const auto s = step({{false, {0}}, {false, {0, 1}}, {false, {}}, {true, {0, 1, 2}}, {false, {0}}, {true, {}}});
  RunList list(s);
  std::vector<uint64_t> versions{1, 1, 1};
  const auto runs = [&] {
    const Flags groups = list.dirty(versions);
    Flags out;
    for (size_t c = 0; c < s.commands.size(); ++c) out.push_back(groups[list.group_of(c)]);
    list.ran(groups, versions);
    return out;
  };
  CHECK(list.group_of(0) == list.group_of(4));
  CHECK(list.group_of(3) == list.group_of(5));
  CHECK(runs() == Flags{1, 1, 1, 1, 1, 1});
  CHECK(runs() == Flags{0, 0, 0, 1, 0, 1});
  versions[2] = 5;
  CHECK(runs() == Flags{0, 0, 0, 1, 0, 1});
  versions[1] = 2;
  CHECK(runs() == Flags{0, 1, 0, 1, 0, 1});
  versions[0] = 2;
  CHECK(runs() == Flags{1, 1, 0, 1, 1, 1});
  CHECK(runs() == Flags{0, 0, 0, 1, 0, 1});
}

TEST_CASE("what did not run stays dirty") {
  const auto s = step({{false, {0}}, {false, {1}}});
  RunList list(s);
  std::vector<uint64_t> versions{1, 1};
  list.ran({true, false}, versions);
  CHECK(list.dirty(versions) == Flags{false, true});
  list.ran({false, true}, versions);
  versions[0] = 2;
  CHECK(list.dirty(versions) == Flags{true, false});
  list.ran({false, false}, versions);
  CHECK(list.dirty(versions) == Flags{true, false});
}

TEST_CASE("what foresees what its step changes runs for the changes of others alone") {
  auto s = step({{false, {0, 1}}, {true, {0, 1}}});
  s.commands[0]->foresees = true;
  s.changes = {1};
  RunList list(s);
  std::vector<uint64_t> versions{1, 1};
  const auto runs = [&] {
    const Flags out = list.dirty(versions);
    list.ran(out, versions);
    ++versions[1];  // by the step
    return out;
  };
  CHECK(runs() == Flags{true, true});
  CHECK(runs() == Flags{false, true});
  CHECK(runs() == Flags{false, true});
  ++versions[1];  // by another
  CHECK(runs() == Flags{true, true});
  CHECK(runs() == Flags{false, true});
  versions[0] = 7;
  CHECK(runs() == Flags{true, true});
  CHECK(runs() == Flags{false, true});
}
