// SPDX-License-Identifier: Apache-2.0
// What an element adds to exact sums in a loop: pixels that read several texels of a moving texture, one after the
// other. The run that guesses exponents adds what the run without guesses does, on a GPU and elsewhere; so do pixels
// whose heavy branches have a dispatch of their own, some of which add nothing.
#include <filesystem>
#include <fstream>
#include <random>

#include "compiler/target/profile.h"
#include "runtime/jit/jit.h"
#include "runtime/runtime.h"
#include "tests/catch.h"
#include "tests/device/compile.h"
#include "tests/device/devices.h"

using namespace dr;
using io::Array;
using test::compile;
using test::must;

namespace {

const char* const kText = R"(edition 1;
param a : float[W, H] = 0.5;
input seen : float[96, 80];
input place : ivec2[96, 80];
let x = if seen > 0.5 { fold(k in 0..5, s = 0.0) { s + a.at(place + ivec2(k, 0)) * float(k + 1) } } else { 0.0 };
step go { a <- a - 0.01 * grad(sum((x - 0.3) * (x - 0.3)), a); }
)";

// As many pixels as a GPU lists for heavy branches, more of them than invocations that share the list.
const char* const kHeavy = R"(edition 1;
param a : float[W, H] = 0.5;
input seen : float[1024, 1024];
input place : ivec2[1024, 1024];
fn much(p: ivec2) -> float {
  reduce(sum, i in 0..2) {
    reduce(sum, j in 0..2) { reduce(sum, k in 0..2) { reduce(sum, l in 0..2) { a.at(p + ivec2(l, i - j * k)) } } }
  }
}
let (on, most) = if seen > 0.9 { let x = detach(much(place)); (x > 4.0, x) } else { (false, 0.0) };
let x = if on { reduce(sum, k in 0..3) { a.at(place + ivec2(k, 0)) * float(k + 1) } } else { most };
step go { a <- a - 0.01 * grad(sum((x - 0.3) * (x - 0.3)), a); }
)";

// What pixels add waits for those beside them, so that the scatter runs by itself: invocations share their loops, of
// which one ends at the last integer. Before and between these something is added once.
const char* const kShared = R"(edition 1;
param a : float[W, H] = 0.5;
input seen : float[P, Q];
input place : ivec2[P, Q];
let count = int(seen * 12.0);
let x = if seen > 0.5 {
  let first = a.at(place.yx) * seen;
  let some = fold(k in 0..count, s = 0.0, max = 12) {
    let inner = reduce(sum, j in 0..min(k % 3, 2)) { a.at(place + ivec2(j, k)) };
    s + a.at(place + ivec2(k, 0)) * float(k + 1) + inner
  };
  let last = 2147483647;
  let more = reduce(sum, k in last - min(count / 2, 6)..last, max = 6) { a.at(place - ivec2(last - k, 1)) * seen };
  first + some * a.at(place) + more
} else { 0.0 };
let y = x - 0.5 * x.at(coord(P, Q).xy + ivec2(1, 0));
step go { a <- a - 0.01 * grad(sum((y - 0.3) * (y - 0.3)), a); }
)";

// Integers that listed pixels combine in loops, which lanes share: sums, vectors, least and largest ones, within an
// inner branch and before a loop that has an order; one ends at the last integer. What is made of them adds to texels.
const char* const kIntegers = R"(edition 1;
param a : float[W, H] = 0.5;
input seen : float[P, Q];
input place : ivec2[P, Q];
fn much(p: ivec2, count: int) -> float {
  let turns = reduce(sum, k in 0..count, max = 13) {
    let inner = reduce(sum, j in 0..k % 4) { int(100.0 * a.at(p + ivec2(j, k))) };
    ivec3(inner - 7 * k, inner & 3, 1)
  };
  let least = if turns.y % 2 == 0 {
    reduce(min, k in 2147483647 - count..2147483647, max = 13) {
      let back = 2147483647 - k;
      reduce(max, j in 0..back) { int(1000.0 * a.at(p + ivec2(back, j))) }
    }
  } else { turns.x };
  let most = reduce(max, k in 0..turns.z + 1, max = 14) {
    var x = 0u;
    for j in 0..k { x = x + uint(abs(least) + j); }
    x % 17u
  };
  1e-4 * float(turns.x + least) + fold(k in 0..int(most), s = 0.0, max = 17) { s * 0.5 + a.at(p - ivec2(k, 0)) }
}
let found = if seen > 0.9 { detach(much(place, int(seen * 1000.0) % 14)) } else { 0.25 };
let x = found * a.at(place);
step go { a <- a - 0.01 * grad(sum((x - 0.3) * (x - 0.3)), a); output found; }
)";

std::string in_build(const std::string& name) { return (std::filesystem::path(DR_BUILD_DIR) / name).string(); }

// A GPU as its compiler sees it, with what any device has.
std::string gpu() {
  auto profile = std::get<target::Profile>(target::load_profile("swiftshader"));
  profile.loop_trips = std::get<target::Profile>(target::load_profile("lavapipe")).loop_trips;
  profile.subgroup_size = 32;
  profile.lanes_in_turn = false;
  std::ofstream(in_build("looped_sums_gpu.json")) << target::write_profile(profile);
  return in_build("looped_sums_gpu.json");
}

// One whose lanes may give each other what they have, and whose loops have no end.
const char* const kShuffling = "looped_sums_shuffling.json";
std::string shuffling() {
  auto profile = std::get<target::Profile>(target::load_profile("swiftshader"));
  profile.loop_trips = 0;
  profile.subgroup_size = 32;
  profile.lanes_in_turn = false;
  profile.subgroup_arithmetic = profile.subgroup_shuffle = true;
  profile.costs = std::get<target::Profile>(target::load_profile("nvidia-h200")).costs;
  std::ofstream(in_build(kShuffling)) << target::write_profile(profile);
  return in_build(kShuffling);
}

// Two runs of a program end with the same texels whether the compiler leaves `part` out or not.
void check_same(const char* text, int width, int height, const std::string& part,
                const std::vector<std::string>& profiles) {
  const std::string path = in_build("looped_sums_test.dr");
  std::ofstream(path) << text;
  constexpr int kTexels = 64;
  std::mt19937 random(5);
  std::vector<float> seen, start;
  std::vector<int32_t> place;
  for (int k = 0; k < width * height; ++k) {
    seen.push_back(static_cast<float>(random() % 1000) / 1000.0F);
    for (int c = 0; c < 2; ++c) place.push_back(static_cast<int32_t>(random() % (kTexels + 4)) - 2);
  }
  for (int k = 0; k < kTexels * kTexels; ++k) start.push_back(static_cast<float>(random() % 1000) / 500.0F - 1.0F);
  const auto twice = [&](runtime::Program program) {
    must(program.bind("seen", Array::from_floats(seen, 1, width, height)));
    must(program.bind("place", Array::from_ints(place, 2, width, height)));
    must(program.bind("a", Array::from_floats(start, 1, kTexels, kTexels)));
    must(program.run("go", 2));
    return must(program.leaf("a")).bytes;
  };
  for (const auto& [name, device] : test::devices())
    for (const std::string& profile : profiles) {
      // A bundle for devices whose loops have no end, which lavapipe refuses.
      if (profile == in_build(kShuffling) && name == std::string("lavapipe")) continue;
      INFO(name << ", profile " << profile);
      jit::Options options;
      options.profile = profile.empty() ? name : profile, options.scatter = "exact";
      const auto bytes = twice(must(runtime::Program::load(device, compile(path, options))));
      options.ablate = {part};
      CHECK(bytes == twice(must(runtime::Program::load(device, compile(path, options)))));
    }
}

}  // namespace

TEST_CASE("sums of what loops add are the same by guesses") { check_same(kText, 96, 80, "guesses", {gpu(), ""}); }

TEST_CASE("sums are the same where invocations share loops, of few elements and of many") {
  for (const auto& [width, height] : {std::pair{20, 11}, {96, 80}, {200, 130}, {500, 300}})
    check_same(kShared, width, height, "guesses", {gpu(), ""});
}

TEST_CASE("integers that lanes combine in loops are the same without a list, of few elements and of many") {
  for (const auto& [width, height] : {std::pair{1, 1}, {20, 11}, {96, 80}, {500, 300}})
    check_same(kIntegers, width, height, "branches", {shuffling(), ""});
}

TEST_CASE("sums of what listed elements add are the same without a list") {
  for (const char* part : {"guesses", "branches"}) check_same(kHeavy, 1024, 1024, part, {gpu(), ""});
}
