// SPDX-License-Identifier: Apache-2.0
// A fit that runs for long: the same bits whether its steps run one by one, in blocks or all at once, no growth of
// memory, and no drift away from what it has reached. DR_STRESS_STEPS sets how many steps.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>

#include "runtime/jit/jit.h"
#include "runtime/runtime.h"
#include "tests/catch.h"
#include "tests/device/compile.h"
#include "tests/device/devices.h"

using namespace dr;
using test::must;

namespace {

// A blurred picture is made sharp, with a random pixel left out each step.
constexpr const char* kProgram = R"(
edition 1;
import std.loss;
import std.optim;
import std.random;
input photo : float[16, 16];
param sharp : float[16, 16] = 0.5;
fn blur(x: float[16, 16]) -> float[16, 16] { 0.5 * x + 0.25 * shift(x, 1, 0) + 0.25 * shift(x, 0, -1) }
let p = coord(16, 16);
let kept = if p.x == random.integer(ivec3(step_index, 0, 0), 3, 16) { 0.0 } else { 1.0 };
let e = loss.masked_l2(blur(sharp), photo, kept);
step fit { minimize e over sharp with optim.adam(rate = 0.002); output loss = e; }
)";

// Fewer pixels than texels, so that texels share them. By the gradient of the one pixel that each remembers they drive
// each other away: 3.4 off after 1,000 steps, 48 after 20,000. Those that nothing reads stay where they are, up to 0.9
// off.
constexpr const char* kTexture = R"(
edition 1;
import std.optim;
import std.texture;
param texels : float[24, 24] = 1.0;
let p = coord(16, 16, 3);
let uv = (vec2(p.xy) + 0.5) / 16.0 * mat2(vec2(0.8, 0.3), vec2(-0.3, 0.8)) + vec2(0.2 + 0.05 * float(p.z), 0.1 * float(p.z));
let place = vec2(coord(24, 24).xy);
let truth = 0.5 + 0.4 * sin(0.7 * place.x) * cos(0.5 * place.y);
let table = texture.inverse_uv(uv, uv.x > 0.0, 24, 24);
let off = texture.bilinear_inverse(texels, uv, table) - texture.bilinear(truth, uv);
let e = 0.5 * sum(off * off);
step fit { minimize e over texels with optim.adam(rate = 0.1, beta1 = 0.5); output farthest = max(abs(texels - truth)); }
)";

long resident_kilobytes() {
  std::ifstream file("/proc/self/status");
  for (std::string word; file >> word;)
    if (word == "VmRSS:") {
      long kilobytes = 0;
      file >> kilobytes;
      return kilobytes;
    }
  return 0;
}

runtime::Program load(const test::NamedDevice& device, const std::vector<uint8_t>& bundle) {
  auto program = must(runtime::Program::load(device.device, bundle));
  std::vector<float> photo(256);
  for (size_t k = 0; k < photo.size(); ++k) photo[k] = 0.5f + 0.4f * std::sin(0.3f * static_cast<float>(k));
  must(program.bind("photo", io::Array::from_floats(photo, 1, 16, 16)));
  return program;
}

int wanted_steps() {
  const char* wanted = std::getenv("DR_STRESS_STEPS");
  const int steps = wanted != nullptr ? std::atoi(wanted) : 1000;
  REQUIRE(steps >= 100);
  return steps;
}

double loss(runtime::Program& program) { return must(program.output("fit", "loss")).to_doubles().at(0); }

}  // namespace

TEST_CASE("a long fit keeps its bits, its memory and what it has reached") {
  const int steps = wanted_steps();
  for (const test::NamedDevice& device : test::devices()) {
    INFO(device.name);
    const std::vector<uint8_t> bundle = test::compile_text("long_run.dr", kProgram, device.name);

    auto blocks = load(device, bundle);
    must(blocks.run("fit"));
    const double first = loss(blocks);
    must(blocks.run("fit", steps / 10 - 1));
    const int64_t allocated = blocks.memory_use().device;
    const long resident = resident_kilobytes();
    double early = 0, late = 0;
    for (int block = 1; block < 10; ++block) {
      must(blocks.run("fit", steps / 10));
      (block == 1 ? early : late) = loss(blocks);
      CHECK(std::isfinite(late));
    }
    const long growth = resident_kilobytes() - resident;
    CHECK(blocks.memory_use().device == allocated);
    CHECK(growth < 1024);
    CHECK(late < 0.1 * first);
    // Adam's steps keep their size; it hovers about the best, and does not leave it.
    CHECK(late < std::max(2 * early, 1e-4));

    auto whole = load(device, bundle), single = load(device, bundle);
    must(whole.run("fit", steps / 10 * 10));
    CHECK(must(whole.leaf("sharp")).bytes == must(blocks.leaf("sharp")).bytes);
    for (int k = 0; k < steps / 10; ++k) must(single.run("fit"));
    must(single.run("fit", steps / 10 * 9));
    CHECK(must(single.leaf("sharp")).bytes == must(whole.leaf("sharp")).bytes);
    for (const std::string& message : device.device.validation_messages()) FAIL("validation: " << message);
    std::printf("%-12s %d steps: loss %.3e, %.3e, %.3e; memory grew by %ld KiB\n", device.name.c_str(), steps / 10 * 10,
                first, early, late, growth);
  }
}

TEST_CASE("texels that share pixels stay where they are in a long fit by inverse UV") {
  const int steps = wanted_steps();
  for (const test::NamedDevice& device : test::devices()) {
    INFO(device.name);
    const std::vector<uint8_t> bundle = test::compile_text("long_run.dr", kTexture, device.name);
    auto program = must(runtime::Program::load(device.device, bundle));
    for (int block = 0; block < 10; ++block) {
      must(program.run("fit", steps / 10));
      CHECK(must(program.output("fit", "farthest")).to_doubles().at(0) < 1);
    }
    for (const std::string& message : device.device.validation_messages()) FAIL("validation: " << message);
  }
}
