// SPDX-License-Identifier: Apache-2.0
// Barriers between commands, as plain data.
#include "runtime/vk/barrier.h"

#include <algorithm>
#include <iterator>
#include <random>

#include "tests/catch.h"

using dr::runtime::Access;
using dr::runtime::Barrier;
using dr::runtime::first_uses;
using dr::runtime::plan_barriers;
using dr::runtime::Scope;
using dr::runtime::scope_of;
using dr::runtime::Use;

namespace {

std::vector<Barrier> plan(std::vector<std::vector<Access>> commands) { return plan_barriers(commands); }

bool waits(const Barrier& b) { return b.from.stages != 0; }

// Whether one of two commands writes what the other touches.
bool meet(const std::vector<Access>& a, const std::vector<Access>& b) {
  return std::ranges::any_of(a, [&](const Access& x) {
    return std::ranges::any_of(b, [&](const Access& y) {
      return x.resource == y.resource && (dr::runtime::writes(x.use) || dr::runtime::writes(y.use));
    });
  });
}

}  // namespace

TEST_CASE("a read waits for the write before it") {
  const auto b = plan({{{0, Use::ComputeWrite}}, {{0, Use::ComputeRead}}});
  CHECK_FALSE(waits(b[0]));
  REQUIRE(waits(b[1]));
  CHECK(b[1].from == scope_of(Use::ComputeWrite));
  CHECK(b[1].to == scope_of(Use::ComputeRead));
}

TEST_CASE("independent commands do not wait") {
  const auto b =
      plan({{{0, Use::ComputeWrite}}, {{1, Use::ComputeWrite}}, {{2, Use::ComputeRead}, {3, Use::ComputeWrite}}});
  for (const Barrier& one : b) CHECK_FALSE(waits(one));
}

TEST_CASE("two readers need one barrier when their stages agree") {
  const auto b = plan({{{0, Use::ComputeWrite}}, {{0, Use::ComputeRead}}, {{0, Use::ComputeRead}}});
  CHECK(waits(b[1]));
  CHECK_FALSE(waits(b[2]));
}

TEST_CASE("a reader at another stage waits again") {
  const auto b = plan({{{0, Use::ComputeWrite}}, {{0, Use::ComputeRead}}, {{0, Use::GraphicsRead}}});
  REQUIRE(waits(b[2]));
  CHECK(b[2].to == scope_of(Use::GraphicsRead));
}

TEST_CASE("a write waits for the readers before it, without making memory available") {
  const auto b = plan({{{0, Use::ComputeRead}}, {{0, Use::ComputeWrite}}});
  REQUIRE(waits(b[1]));
  CHECK(b[1].from.stages == scope_of(Use::ComputeRead).stages);
  CHECK(b[1].from.access == 0);
}

TEST_CASE("a write does not wait again for readers that a barrier was behind") {
  const auto b = plan({{{0, Use::ComputeRead}, {1, Use::ComputeWrite}},
                       {{1, Use::ComputeRead}},
                       {{0, Use::ComputeWrite}},
                       {{1, Use::ComputeWrite}}});
  CHECK(waits(b[1]));
  CHECK_FALSE(waits(b[2]));
  CHECK(waits(b[3]));
}

TEST_CASE("a barrier for one stage does not let another write what is read") {
  const auto b =
      plan({{{0, Use::ComputeRead}, {1, Use::ComputeWrite}}, {{1, Use::ComputeRead}}, {{0, Use::TransferWrite}}});
  CHECK(waits(b[1]));
  CHECK(waits(b[2]));
}

TEST_CASE("commands stand one level behind what they wait for") {
  // A run: clear 0, write 1 by 0, write 2 by 1. The clear of the next run needs what reads 0 alone to be over.
  const std::vector<std::vector<Access>> run{{{0, Use::TransferWrite}},
                                             {{0, Use::ComputeReadWrite}, {1, Use::ComputeWrite}},
                                             {{1, Use::ComputeRead}, {2, Use::ComputeReadWrite}}};
  std::vector<std::vector<Access>> two = run;
  two.insert(two.end(), run.begin(), run.end());
  CHECK(dr::runtime::by_level(two) == std::vector<std::vector<size_t>>{{0}, {1}, {2, 3}, {4}, {5}});
}

TEST_CASE("levels keep every order that reads and writes ask for") {
  std::mt19937 random(5);
  constexpr Use kUses[] = {Use::ComputeRead,  Use::ComputeWrite, Use::ComputeReadWrite,
                           Use::GraphicsRead, Use::ColorWrite,   Use::DepthWrite,
                           Use::IndirectRead, Use::TransferRead, Use::TransferWrite};
  for (int round = 0; round < 200; ++round) {
    std::vector<std::vector<Access>> commands(12);
    for (auto& accesses : commands)
      for (int k = 0; k < 3; ++k)
        accesses.push_back({static_cast<uint32_t>(random() % 6), kUses[random() % std::size(kUses)]});
    const std::vector<std::vector<size_t>> levels = dr::runtime::by_level(commands);
    std::vector<size_t> of(commands.size());
    for (size_t level = 0; level < levels.size(); ++level)
      for (const size_t k : levels[level]) of[k] = level;
    for (size_t b = 0; b < commands.size(); ++b)
      for (size_t a = 0; a < b; ++a)
        if (meet(commands[a], commands[b])) REQUIRE(of[a] < of[b]);
  }
}

TEST_CASE("writes in a row wait for each other") {
  const auto b = plan({{{0, Use::TransferWrite}}, {{0, Use::ComputeReadWrite}}, {{0, Use::ComputeReadWrite}}});
  CHECK(waits(b[1]));
  CHECK(waits(b[2]));
}

TEST_CASE("one barrier covers earlier writes of the same scope") {
  const auto b =
      plan({{{0, Use::ComputeWrite}}, {{1, Use::ComputeWrite}}, {{0, Use::ComputeRead}}, {{1, Use::ComputeRead}}});
  CHECK(waits(b[2]));
  CHECK_FALSE(waits(b[3]));
}

TEST_CASE("what is visible to one stage by one access is not visible to all by all") {
  const auto b = plan({{{0, Use::ComputeWrite}, {1, Use::ComputeWrite}},
                       {{1, Use::ComputeWrite}},
                       {{0, Use::GraphicsRead}},
                       {{0, Use::ComputeRead}}});
  CHECK(waits(b[1]));
  CHECK(waits(b[2]));
  REQUIRE(waits(b[3]));
  CHECK(b[3].to == scope_of(Use::ComputeRead));
}

TEST_CASE("attachments are read after they are written, and cleared after they are read") {
  const auto b = plan({{{0, Use::ColorWrite}, {1, Use::DepthWrite}},
                       {{0, Use::GraphicsRead}, {2, Use::ColorWrite}, {1, Use::DepthWrite}},
                       {{0, Use::ColorWrite}}});
  REQUIRE(waits(b[1]));
  CHECK((b[1].from.stages & scope_of(Use::ColorWrite).stages) != 0);
  CHECK((b[1].from.stages & scope_of(Use::DepthWrite).stages) == scope_of(Use::DepthWrite).stages);
  REQUIRE(waits(b[2]));
  CHECK((b[2].from.stages & scope_of(Use::GraphicsRead).stages) == scope_of(Use::GraphicsRead).stages);
}

TEST_CASE("numbers of workgroups wait for the shader that writes them, and it for what reads them") {
  const auto b = plan({{{0, Use::ComputeWrite}}, {{0, Use::IndirectRead}}, {{0, Use::ComputeWrite}}});
  REQUIRE(waits(b[1]));
  CHECK(b[1].from == scope_of(Use::ComputeWrite));
  CHECK(b[1].to == scope_of(Use::IndirectRead));
  REQUIRE(waits(b[2]));
  CHECK((b[2].from.stages & scope_of(Use::IndirectRead).stages) != 0);
}

TEST_CASE("first uses are those up to the first write of each resource") {
  const std::vector<std::vector<Access>> commands = {{{0, Use::ComputeRead}, {1, Use::TransferWrite}},
                                                     {{1, Use::IndirectRead}, {0, Use::ComputeWrite}},
                                                     {{0, Use::IndirectRead}}};
  const Scope read = scope_of(Use::ComputeRead), write = scope_of(Use::ComputeWrite),
              copy = scope_of(Use::TransferWrite);
  CHECK(first_uses(commands) ==
        Scope{read.stages | write.stages | copy.stages, read.access | write.access | copy.access});
  CHECK(first_uses({}).stages == 0);
  // Numbers of workgroups that an earlier submission wrote.
  const std::vector<std::vector<Access>> list = {{{2, Use::IndirectRead}, {2, Use::ComputeWrite}}};
  CHECK((first_uses(list).stages & scope_of(Use::IndirectRead).stages) != 0);
}
