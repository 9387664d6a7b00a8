// SPDX-License-Identifier: Apache-2.0
// Updates whose elements rest: those that nothing was added to, and that the update would leave as they are, are
// neither read nor stepped. The bits left are those of a program that steps all elements (the pass `stepped` ablated).
#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <span>
#include <tuple>

#include "compiler/backend/bundle/bundle.h"
#include "compiler/target/profile.h"
#include "runtime/jit/jit.h"
#include "runtime/runtime.h"
#include "tests/catch.h"
#include "tests/device/compile.h"
#include "tests/device/devices.h"
#include "tests/device/scatters.h"

using namespace dr;
using io::Array;
using test::compile;
using test::Data;
using test::data_sets;
using test::must;
using test::narrow;
using test::same_bits;
using test::written;

namespace {

// Updates of `tone` and `shade`, images of so many elements in a row and rows, leave the same bits whether elements
// rest or all are stepped. A factor that is Inf or NaN reaches some; one that is 0 reaches none.
// `reads`: how the program reads both.
void check_rest(const std::string& reads, const std::string& profile, const runtime::Device& device,
                std::array<int, 2> extent, bool guesses) {
  const auto path = (std::filesystem::path(DR_BUILD_DIR) / "scatter_rest_test.dr").string();
  std::ofstream(path) << R"(edition 1;
import std.optim;
input index : ivec2[S];
input x : vec2[S];
input factor : float;
)" << reads << R"(step run {
  minimize sum(dot(read, read)) over tone with optim.adam(rate = 0.01);
  shade <- shade + 0.01 * grad(sum(apart), shade);
}
)";
  const Data data = data_sets()[1];
  const auto [width, height] = extent;
  std::vector<float> tone, shade;
  for (int k = 0; k < width * height; ++k) {
    for (int c = 0; c < 3; ++c) tone.push_back(k % 500 == 499 ? NAN : 0.25F * static_cast<float>(k % 7 + c) - 0.5F);
    for (int c = 0; c < 2; ++c) shade.push_back((k + c) % 5 == 0 ? -0.0F : 0.5F);  // -0 and 0 is 0
  }
  const auto image = [&](const std::vector<float>& values, int components, int w, int h) {
    return h == 1 ? Array::from_floats(values, components) : Array::from_floats(values, components, w, h);
  };
  const auto once = [&](auto& program, float factor, int way) {
    must(program.bind("index", Array::from_ints(data.index, 2)));
    must(program.bind("x", Array::from_floats(data.x, 2)));
    must(program.bind("tone", image(tone, 3, width, height)));
    must(program.bind("shade", height == 1 ? image(shade, 2, width, 1) : image(shade, 2, height, width)));
    must(program.bind("factor", Array::from_floats(std::span(&factor, 1))));
    if (way == 0) must(program.run("run", 3));
    if (way == 1) must(program.timed_run("run"));
    if (way == 2) must(program.checked_run("run"));
    return std::vector<Array>{must(program.leaf("tone")), must(program.leaf("shade"))};
  };
  jit::Options options;
  options.profile = profile, options.scatter = "exact";
  if (!guesses) options.ablate = {"guesses"};
  auto resting = must(runtime::Program::load(device, compile(path, options)));
  options.ablate.push_back("stepped");
  auto all = must(runtime::Program::load(device, compile(path, options)));
  for (const float factor : {1.0F, 3e4F, INFINITY, 1e-7F, NAN, 0.0F, 2.5F, -1.0F})
    for (const int way : {0, 1, 2}) {
      INFO("guesses " << guesses << ", factor " << factor << ", way " << way);
      CHECK(same_bits(once(resting, factor, way), once(all, factor, way)));
    }
  int64_t listed = 0, elements = 0;
  for (const auto& command : must(resting.timed_run("run")))
    if (command.list == "stepped") listed += command.listed, elements += command.elements;
  CHECK(elements == 2 * width * height);
  CHECK(0 < listed);
  CHECK(listed < elements);
}

}  // namespace

// Sums that wake blocks of an update's elements: those that nothing was added to, and that the update would leave as
// they are, are neither read nor stepped.
TEST_CASE("an update that runs for marked blocks leaves what one for all elements does") {
  auto gpu = std::get<target::Profile>(target::load_profile(narrow()));
  gpu.subgroup_size = 32;
  const std::string plain = written(gpu, "marked");
  for (const auto& [name, device] : test::devices())
    for (const bool guesses : {true, false}) {
      INFO(name);
      check_rest(R"(param tone : vec3[T, U] = vec3(1.5);
param shade : vec2[U, T] = vec2(0.5);
let p = ivec2(index.x % 37, index.x / 37 * 4);
let q = ivec2(index.y % 37, index.y / 37 * 3);
let read = tone.at(p) * factor * x.x + tone.at(q);
let apart = shade.at(p.yx).x * shade.at(q.yx).y * x.y * factor;
)",
                 plain, device, {37, 41}, guesses);
    }
}

// Where lanes are in turn, elements of a list have a bit each. Other devices have no texels of three words, as such
// programs read them.
TEST_CASE("an update that goes from bit to bit leaves what one for all elements does") {
  auto in_turn = std::get<target::Profile>(target::load_profile(narrow()));
  in_turn.lanes_in_turn = true;
  const std::string plain = written(in_turn, "in_turn");
  for (const auto& [name, device] : test::devices())
    for (const std::string& profile : {name, plain}) {
      if (name != "lavapipe") continue;
      INFO(profile);
      check_rest(R"(param tone : vec3[T] = vec3(1.5);
param shade : vec2[R] = vec2(0.5);
let p = index.x % 37 + index.x / 37 * 148;
let q = index.y % 37 + index.y / 37 * 111;
let read = tone.at(p) * factor * x.x + tone.at(q);
let apart = shade.at(p).x * shade.at(q).y * x.y * factor;
)",
                 profile, device, {1517, 1}, true);
    }
}

// A device with few storage buffers splits passes where one hands a matrix to the next: that it is not zero tells which
// elements add.
TEST_CASE("elements that add are told by a matrix, too") {
  auto few = std::get<target::Profile>(target::load_profile("lavapipe"));
  few.max_per_stage_descriptor_storage_buffers = 4;
  const auto path = (std::filesystem::path(DR_BUILD_DIR) / "scatter_matrix_test.dr").string();
  std::ofstream(path) << R"(edition 1;
param texel : vec2[10000, 1] = 0.25;
param other : float[10000, 1] = 0.25;
param bias : vec2;
state velocity : vec2[10000, 1];
state move : float;
input place : vec2[64, 16];
input target : float[64, 16];
let uv : vec2[64, 16] = vec2((place * 0.5 + vec2(move, 0.5 * move)).x, 0.5);
let color : vec2[64, 16] = if target > 3.0 { sample(texel, uv, wrap = repeat) + bias } else { vec2(0.0) };
let d = color.x - target + sample(other, uv, filter = nearest, wrap = repeat);
let e = mean(d * d) + 0.1 * mean(dot(color, color));
step run {
  let n = 0.5 * velocity + grad(e, texel);
  velocity <- n;
  texel <- if length(n) > 0.0 { clamp(texel - 0.125 * n, -1.0, 1.0) } else { texel };
  move <- move + 0.5;
}
)";
  CHECK(bundle::check(std::get<bundle::BundleT>(bundle::read(compile(path, written(few, "few"), "auto")))).empty());
}

// Elements without a gradient do not keep what they hold: zero, or what another state makes of them, comes in its
// place.
TEST_CASE("an update that does not keep what it gets no gradient for runs for all elements") {
  auto gpu = std::get<target::Profile>(target::load_profile(narrow()));
  gpu.subgroup_size = 32;
  const std::string marked = written(gpu, "forgets");
  const Data data = data_sets()[1];
  const std::vector<float> fives(1517, 5.0F);
  for (const auto& [name, device] : test::devices())
    for (const auto& [profile, extent, place] : {std::tuple(name, "1517", "index.x % 37 + index.x / 37 * 148"),
                                                 std::tuple(name, "37, 41", "ivec2(index.x % 37, index.x / 37 * 4)"),
                                                 std::tuple(marked, "37, 41", "ivec2(index.x % 37, index.x / 37 * 4)")})
      for (const char* update : {"w <- 0.5 * g;", "w <- 0.5 * detach(v) + g;", "w <- if g != 0.0 { w } else { 0.0 };",
                                 "w <- g + 0.5 * v; v <- 0.9 * v + g;", "w <- w - 0.1 * g * inversesqrt(g * g);"}) {
        INFO(name << ", " << profile << ", [" << extent << "], " << update);
        const auto path = (std::filesystem::path(DR_BUILD_DIR) / "scatter_forgets_test.dr").string();
        std::ofstream(path) << "edition 1;\ninput index : ivec2[S];\ninput x : vec2[S];\n"
                            << "param t : float[" << extent << "] = 0.5;\nparam w : float[" << extent
                            << "];\nstate v : float[" << extent << "];\nlet read = t.at(" << place
                            << ") * x.x;\nlet g = grad(sum(read * read), t);\nstep run { " << update << " }\n";
        const auto once = [&](const std::vector<std::string>& ablate, int runs) {
          jit::Options options;
          options.profile = profile, options.scatter = "exact", options.ablate = ablate;
          auto program = must(runtime::Program::load(device, compile(path, options)));
          must(program.bind("index", Array::from_ints(data.index, 2)));
          must(program.bind("x", Array::from_floats(data.x, 2)));
          const bool row = std::string(extent) == "1517";
          must(program.bind("w", row ? Array::from_floats(fives) : Array::from_floats(fives, 1, 37, 41)));
          must(program.run("run", runs));
          return std::vector<Array>{must(program.leaf("w"))};
        };
        for (const int runs : {1, 3}) CHECK(same_bits(once({}, runs), once({"stepped"}, runs)));
        const auto seen = once({}, 1)[0].as<float>();
        CHECK(std::ranges::count(seen, 5.0F) < 300);  // those that have a gradient, at most
      }
}
