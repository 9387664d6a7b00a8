// SPDX-License-Identifier: Apache-2.0
// drun --check-against-reference: right programs agree, and one whose shaders are not those of its graph is found, with
// the pass and the line of what differs first.
#include "runtime/jit/reference_check.h"

#include <algorithm>
#include <bit>
#include <filesystem>
#include <fstream>

#include "compiler/backend/bundle/bundle.h"
#include "runtime/runtime.h"
#include "tests/catch.h"
#include "tests/device/compile.h"
#include "tests/device/devices.h"

using namespace dr;
using io::Array;
using test::must;

namespace {

// 3.25 and 1.75 stand in no other place.
const char* const kProgram = R"(edition 1;
input a : float[W, H];
param x : float[W] = 0.5;
let seen = raster(2, W, H) {
  setup(f) -> float { float(f) }
  corner(s, c) -> vec2 { [vec2(0.0, 0.3), vec2(9.0, 0.0), vec2(0.0, 7.0)][c] }
  depth(s, p) -> float { 0.5 - s * 0.1 }
}[0];
let y = sin(a * x) * 3.25 + float(seen.face);
let total = sum(y);
let around = total * 1.75 + a;
step fit {
  x <- x - 0.1 * grad(sum(y * y), x);
  output y, total, around;
}
)";

// The bundle with another constant in its shaders.
std::vector<uint8_t> with_constant(const std::vector<uint8_t>& bytes, float from, float to) {
  auto bundle = std::get<bundle::BundleT>(bundle::read(bytes));
  int64_t changed = 0;
  for (const auto& shader : bundle.shaders) {
    changed += std::ranges::count(shader->spirv, std::bit_cast<uint32_t>(from));
    std::ranges::replace(shader->spirv, std::bit_cast<uint32_t>(from), std::bit_cast<uint32_t>(to));
  }
  REQUIRE(changed > 0);
  return bundle::write(bundle);
}

jit::Comparison compared(const runtime::Device& device, const std::vector<uint8_t>& bundle, int runs) {
  auto program = must(runtime::Program::load(device, bundle));
  auto check = must(jit::ReferenceCheck::load(bundle));
  must(program.bind("a", Array::from_floats(std::vector<float>{1, 2, 3, 4, 5, 6}, 1, 3, 2)));
  jit::Comparison last;
  for (int k = 0; k < runs; ++k) last = must(check.run(program, "fit", k));
  return last;
}

}  // namespace

TEST_CASE("a device that computes what the graph says agrees with the reference") {
  for (const auto& [name, device] : test::devices()) {
    INFO(name);
    const auto bundle = test::compile_text("reference_check.dr", kProgram, name);
    const jit::Comparison found = compared(device, bundle, 3);
    CHECK(found.values == 6);  // face, tag, y, total, around, x
    for (const jit::Difference& d : found.differ) FAIL(describe(d));
  }
}

TEST_CASE("what a wrong shader gives first is named with its pass and lines") {
  for (const auto& [name, device] : test::devices()) {
    INFO(name);
    const auto bundle = test::compile_text("reference_check.dr", kProgram, name);
    const auto late = compared(device, with_constant(bundle, 1.75F, 1.5F), 1);
    REQUIRE(late.differ.size() == 1);
    CHECK(late.differ[0].value == "around");
    CHECK(late.differ[0].count == 6);
    CHECK(std::ranges::any_of(late.differ[0].lines, [](const std::string& l) { return l.ends_with(".dr:11"); }));
    const auto early = compared(device, with_constant(bundle, 3.25F, 3.0F), 1);
    REQUIRE(early.differ.size() == 4);
    CHECK(early.differ[0].value == "y");
    CHECK(std::ranges::any_of(early.differ[0].lines, [](const std::string& l) { return l.ends_with(".dr:9"); }));
  }
}

TEST_CASE("a difference of a few parts in a thousand is found, of one element, too") {
  const std::string text =
      "edition 1;\ninput a : float[W, H];\nstep fit { output y = if a > 5.5 { a * 3.25 } else { a }; }\n";
  for (const auto& [name, device] : test::devices()) {
    INFO(name);
    const auto bundle = test::compile_text("reference_check_one.dr", text, name);
    CHECK(compared(device, bundle, 1).differ.empty());
    const auto found = compared(device, with_constant(bundle, 3.25F, 3.26F), 1);
    REQUIRE(found.differ.size() == 1);
    CHECK(found.differ[0].count == 1);
    CHECK(found.differ[0].place.x == 2);
    CHECK(found.differ[0].place.y == 1);
  }
}
