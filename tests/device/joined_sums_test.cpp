// SPDX-License-Identifier: Apache-2.0
// Exact sums that a map adds to: what its workgroups and pairs of lanes join, what it adds for several scatters, and
// sums that a scatter reads as they are. All of them have the bits of what invocations add alone.
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <random>

#include "compiler/backend/bundle/bundle.h"
#include "compiler/target/profile.h"
#include "runtime/jit/jit.h"
#include "runtime/jit/reference_program.h"
#include "runtime/runtime.h"
#include "tests/catch.h"
#include "tests/device/compile.h"
#include "tests/device/devices.h"
#include "tests/device/scatters.h"

using namespace dr;
using io::Array;
using test::compile;
using test::distance;
using test::must;
using test::narrow;
using test::same_bits;
using test::written;

namespace {

constexpr double kTolerance = 1e-6;  // relative L2

}  // namespace

// Pictures that squares of 16 x 16 fill, and others; textures with a few texels, for which all pixels wait, and with
// more than a workgroup's memory has room for.
TEST_CASE("what workgroups, or pairs of lanes, add up together is what invocations add alone") {
  const auto path = (std::filesystem::path(DR_BUILD_DIR) / "scatter_groups_test.dr").string();
  std::ofstream(path) << R"(edition 1;
import std.texture;
input size : vec2[W, H];
input factor : float;
param texels : vec3[T, R] = vec3(0.7);
let p = coord(W, H).xy;
let place = vec2(p) * size.x + 0.3 * sin(vec2(p.yx));
let color = if (p.x + p.y) % 7 > 1 { texture.bilinear(texels, fract(place)) } else { vec3(0.0) };
let pull = grad(sum(factor * size.y * color * color), texels);
step run { texels <- texels - 0.01 * pull; }
)";
  auto gpu = std::get<target::Profile>(target::load_profile(narrow()));
  auto wide = std::get<target::Profile>(target::load_profile("lavapipe"));
  gpu.subgroup_size = wide.subgroup_size = 32;
  gpu.lanes_in_turn = wide.lanes_in_turn = false;
  auto pairs = gpu;
  pairs.subgroup_arithmetic = pairs.subgroup_shuffle = true;
  pairs.costs = std::get<target::Profile>(target::load_profile("nvidia-h200")).costs;
  for (const auto& [name, device] : test::devices())
    for (const std::string& profile : {written(gpu, "in_groups"), written(wide, "in_groups_wide")}) {
      jit::Options options;
      options.profile = profile, options.scatter = "exact";
      const auto joined = compile(path, options);
      const auto bundle = std::get<bundle::BundleT>(bundle::read(joined));
      CHECK(std::ranges::any_of(bundle.steps[0]->commands, [](const auto& c) { return c->group == 256; }));
      options.ablate = {"guesses"};
      const auto apart = compile(path, options);
      options.profile = written(pairs, "in_pairs");
      const auto paired = compile(path, options);
      CHECK(std::ranges::count(std::get<bundle::BundleT>(bundle::read(paired)).features,
                               bundle::Feature::SubgroupShuffle) == 1);
      if (profile.find("wide") != std::string::npos && !runtime::Program::load(device, joined)) continue;
      for (const auto& [w, h] : {std::pair{64, 48}, {40, 33}, {5, 3}})
        for (const auto& [across, texels] : {std::pair{0.013F, 3}, {0.4F, 350}}) {
          auto program = must(runtime::Program::load(device, joined)),
               plain = must(runtime::Program::load(device, apart)), two = must(runtime::Program::load(device, paired));
          std::vector<float> size, start(static_cast<size_t>(texels) * 2 * 3 * 3);
          std::mt19937 random(11);
          for (int k = 0; k < w * h; ++k)
            for (const float times : {across, std::ldexp(1.0F, static_cast<int>(random() % 40) - 20)})
              size.push_back(times);
          for (float& x : start) x = static_cast<float>(random() % 1000) / 500.0F - 1.0F;
          const auto once = [&](auto& any, float factor) {
            must(any.bind("size", Array::from_floats(size, 2, w, h)));
            must(any.bind("texels", Array::from_floats(start, 3, texels * 2, 3)));
            must(any.bind("factor", Array::from_floats(std::span(&factor, 1))));
            must(any.run("run", 2));
            return std::vector<Array>{must(any.leaf("texels"))};
          };
          for (const float factor : {1.0F, 1.0F, 3e4F, INFINITY, 1e-30F, NAN, 0.0F, -2.5F}) {
            INFO(name << ", " << w << " x " << h << ", texture of " << texels * 2 << ", factor " << factor);
            const auto found = once(plain, factor);
            CHECK(same_bits(once(program, factor), found));
            CHECK(same_bits(once(two, factor), found));
          }
        }
    }
}

// A map that adds to texels and to vertices at all pixels, by workgroups, and to tones and glows at some, which it
// lists apart.
TEST_CASE("what one map adds for several scatters is what they add alone") {
  const auto path = (std::filesystem::path(DR_BUILD_DIR) / "scatter_united_test.dr").string();
  std::ofstream(path) << R"(edition 1;
input size : vec2[W, H];
input corner : ivec3[W, H];
input factor : float;
param texels : vec3[T, R] = vec3(0.7);
param vertex : vec3[V] = vec3(0.2);
param tone : float[K] = 0.4;
param glow : float[K] = 0.4;
let p = coord(W, H).xy;
let normal = vertex.at(corner.x) * size.y + vertex.at(corner.y) * 0.5 + vertex.at(corner.z) * size.x;
let lit = (texels.at(corner.xy) + 0.5 * texels.at(corner.zx / 4)) * normal;
let shadow = if (p.x + p.y) % 7 > 4 { tone.at(corner.x) * lit.x * size.y } else { 0.0 };
let shine = if (p.x + p.y) % 5 > 3 { glow.at(corner.y) * lit.y * factor } else { 0.0 };
let error = sum(factor * size.y * lit * lit) + sum(shadow * shadow) + sum(shine);
step run {
  texels <- texels - 0.01 * grad(error, texels);
  vertex <- vertex - 0.01 * grad(error, vertex);
  tone <- tone - 0.01 * grad(error, tone);
  glow <- glow - 0.01 * grad(error, glow);
}
)";
  constexpr int kWidth = 40, kHeight = 33, kAcross = 20, kDown = 7, kVertices = 30;
  std::mt19937 random(3);
  const auto numbers = [&](size_t count) {
    std::vector<float> out(count);
    for (float& x : out) x = static_cast<float>(random() % 1000) / 1000.0F;
    return out;
  };
  const auto size = numbers(size_t{2} * kWidth * kHeight), texels = numbers(size_t{3} * kAcross * kDown),
             vertex = numbers(size_t{3} * kVertices), tone = numbers(kVertices);
  std::vector<int32_t> corner(size_t{3} * kWidth * kHeight);
  for (int32_t& v : corner) v = static_cast<int32_t>(random() % (kVertices + 2)) - 1;
  const auto once = [&](auto& program, float factor) {
    must(program.bind("size", Array::from_floats(size, 2, kWidth, kHeight)));
    must(program.bind("corner", Array::from_ints(corner, 3, kWidth, kHeight)));
    must(program.bind("factor", Array::from_floats(std::span(&factor, 1))));
    must(program.bind("texels", Array::from_floats(texels, 3, kAcross, kDown)));
    must(program.bind("vertex", Array::from_floats(vertex, 3)));
    must(program.bind("tone", Array::from_floats(tone)));
    must(program.bind("glow", Array::from_floats(tone)));
    must(program.run("run"));
    std::vector<Array> out;
    for (const char* leaf : {"texels", "vertex", "tone", "glow"}) out.push_back(must(program.leaf(leaf)));
    return out;
  };
  auto reference = must(jit::ReferenceProgram::load(compile(path, "lavapipe", "exact")));
  const auto truth = once(reference, 1.0F);
  auto gpu = std::get<target::Profile>(target::load_profile(narrow()));
  gpu.costs = std::get<target::Profile>(target::load_profile("nvidia-h200")).costs;
  gpu.subgroup_size = 32;
  gpu.subgroup_arithmetic = true;
  gpu.lanes_in_turn = false;
  for (const auto& [name, device] : test::devices()) {
    jit::Options options;
    options.profile = written(gpu, "united"), options.scatter = "exact";
    const auto united = compile(path, options);
    const auto bundle = std::get<bundle::BundleT>(bundle::read(united));
    CHECK(std::ranges::count(bundle.resources, bundle::Role::Guess, [](const auto& r) { return r->role; }) == 4);
    const auto& commands = bundle.steps[0]->commands;
    CHECK(std::ranges::count_if(commands, [](const auto& c) { return c->group == 256; }) == 1);
    options.ablate = {"guesses"};
    auto program = must(runtime::Program::load(device, united)),
         apart = must(runtime::Program::load(device, compile(path, options))),
         alone = must(runtime::Program::load(device, compile(path, narrow(), "exact")));
    for (const float factor : {1.0F, 1.0F, 3e4F, INFINITY, 1e-30F, NAN, 0.0F, -2.5F, 1.0F}) {
      INFO(name << ", factor " << factor);
      const auto found = once(program, factor);
      CHECK(same_bits(found, once(apart, factor)));
      CHECK(same_bits(found, once(alone, factor)));
      for (size_t k = 0; factor == 1.0F && k < found.size(); ++k) CHECK(distance(found[k], truth[k]) <= kTolerance);
    }
  }
}

// A map that has to remember more than a shader's registers hold: its workgroups are larger.
TEST_CASE("large workgroups add up what small ones do") {
  const auto path = (std::filesystem::path(DR_BUILD_DIR) / "large_groups_test.dr").string();
  std::ofstream(path) << R"(edition 1;
import std.texture;
input size : vec2[W, H];
input factor : float;
param texels : vec3[T, R] = vec3(0.7);
let p = coord(W, H).xy;
let place = vec2(p) * size.x + 0.3 * sin(vec2(p.yx));
let color = if (p.x + p.y) % 7 > 1 { texture.bilinear(texels, fract(place)) } else { vec3(0.0) };
let many = array(40, fn(k) { sin(float(k + 1) * color) });
fn mixed(many: array<vec3[_, _], 40>) {
  var all = vec3(0.0);
  for k in 0..40 { all = all + many[k] * many[39 - k]; }
  all
}
let pull = grad(sum(factor * size.y * mixed(many)), texels);
step run { texels <- texels - 0.01 * pull; }
)";
  auto gpu = std::get<target::Profile>(target::load_profile(narrow()));
  gpu.subgroup_size = 32;
  gpu.lanes_in_turn = false;
  gpu.max_compute_work_group_invocations = 512;
  auto small = gpu;
  small.max_compute_work_group_invocations = 256;
  for (const auto& [name, device] : test::devices()) {
    jit::Options options;
    options.profile = written(gpu, "large_groups"), options.scatter = "exact";
    const auto large = compile(path, options);
    options.profile = written(small, "small_groups");
    const auto few = compile(path, options);
    options.ablate = {"guesses"};
    const auto apart = compile(path, options);
    const auto groups_of = [](const std::vector<uint8_t>& bytes, uint32_t group) {
      const auto bundle = std::get<bundle::BundleT>(bundle::read(bytes));
      return std::ranges::count_if(bundle.steps[0]->commands, [&](const auto& c) { return c->group == group; });
    };
    CHECK(groups_of(large, 512) == 1);
    CHECK(groups_of(few, 256) == 1);
    auto loaded = runtime::Program::load(device, large);
    if (!loaded) continue;  // the device has smaller ones only
    auto program = must(std::move(loaded)), other = must(runtime::Program::load(device, few)),
         plain = must(runtime::Program::load(device, apart));
    constexpr int kWidth = 40, kHeight = 33, kTexels = 24;
    std::vector<float> size;
    std::mt19937 random(11);
    for (int k = 0; k < kWidth * kHeight; ++k)
      for (const float times : {0.013F, std::ldexp(1.0F, static_cast<int>(random() % 40) - 20)}) size.push_back(times);
    const auto once = [&](auto& any, float factor) {
      must(any.bind("size", Array::from_floats(size, 2, kWidth, kHeight)));
      must(
          any.bind("texels", Array::from_floats(std::vector<float>(3 * kTexels * kTexels, 0.5F), 3, kTexels, kTexels)));
      must(any.bind("factor", Array::from_floats(std::span(&factor, 1))));
      must(any.run("run", 2));
      return std::vector<Array>{must(any.leaf("texels"))};
    };
    for (const float factor : {1.0F, 1.0F, 3e4F, INFINITY, 1e-30F, NAN, 0.0F, -2.5F}) {
      INFO(name << ", factor " << factor);
      const auto found = once(plain, factor);
      CHECK(same_bits(once(program, factor), found));
      CHECK(same_bits(once(other, factor), found));
    }
  }
}

// Where lanes go in turn, a map adds by itself to texels and vertices, in a dispatch of its own where a heavy branch is
// taken, or for what a select chooses. Elsewhere it adds nothing to the texels; in the first program it adds something
// to the vertices and to the tones in any case.
TEST_CASE("a map of lanes in turn adds what scatters of their own add") {
  const std::string path = (std::filesystem::path(DR_BUILD_DIR) / "added_in_turn_test.dr").string();
  const bool by_select = GENERATE(false, true);
  // What shines is computed in a branch, or everywhere and then chosen.
  std::ofstream(path) << R"(edition 1;
input size : vec2[W, H];
input corner : ivec3[W, H];
input factor : float;
param texels : vec3[T, R] = vec3(0.7);
param vertex : vec3[V] = vec3(0.2);
param tone : float[K] = 0.4;
let n = vertex.at(corner.x) * size.y + vertex.at(corner.y) * 0.5 + vertex.at(corner.z) * size.x;
let seen = size.y > 0.3005;
let base = texels.at(corner.xy) + 0.5 * texels.at(corner.zx / 4);
fn shining(n: vec3) -> float {
  exp(-dot(n, n)) + pow(abs(n.x) + 0.1, 2.5) + sin(3.0 * n.y) * cos(n.z) + atan(n.y, n.x + 2.0) + tanh(n.z)
}
)"
                      << (by_select ? R"(
let everywhere = shining(n) * base;
let color = if seen { everywhere } else { vec3(0.0) };
let glowing = (size.x + everywhere.y) * tone.at(corner.x);
let pale = if seen { glowing } else { 0.0 };
let error = sum(factor * size.y * color * color) + sum(pale * pale);
)"
                                    : R"(
let shine = if seen { shining(n) } else { 0.0 };
let color = shine * base;
let pale = (size.x + shine) * tone.at(corner.x);
let error = sum(factor * size.y * color * color) + sum(factor * dot(n, n) * size.x) + sum(pale * pale);
)") << R"(
step run {
  texels <- texels - 0.01 * grad(error, texels);
  vertex <- vertex - 0.01 * grad(error, vertex);
  tone <- tone - 0.01 * grad(error, tone);
}
)";
  constexpr int kWidth = 40, kHeight = 33, kAcross = 20, kDown = 7, kVertices = 100;
  std::mt19937 random(3);
  const auto numbers = [&](size_t count) {
    std::vector<float> out(count);
    for (float& x : out) x = static_cast<float>(random() % 1000) / 1000.0F;
    return out;
  };
  const auto size = numbers(size_t{2} * kWidth * kHeight), texels = numbers(size_t{3} * kAcross * kDown),
             vertex = numbers(size_t{3} * kVertices), tone = numbers(kVertices);
  std::vector<int32_t> corner(size_t{3} * kWidth * kHeight);
  for (int32_t& v : corner) v = static_cast<int32_t>(random() % (kVertices + 2)) - 1;
  const auto once = [&](auto& program, float factor) {
    must(program.bind("size", Array::from_floats(size, 2, kWidth, kHeight)));
    must(program.bind("corner", Array::from_ints(corner, 3, kWidth, kHeight)));
    must(program.bind("factor", Array::from_floats(std::span(&factor, 1))));
    must(program.bind("texels", Array::from_floats(texels, 3, kAcross, kDown)));
    must(program.bind("vertex", Array::from_floats(vertex, 3)));
    must(program.bind("tone", Array::from_floats(tone)));
    must(program.run("run"));
    std::vector<Array> out;
    for (const char* leaf : {"texels", "vertex", "tone"}) out.push_back(must(program.leaf(leaf)));
    return out;
  };
  auto turns = std::get<target::Profile>(target::load_profile(narrow()));
  turns.lanes_in_turn = true;
  for (const auto& [name, device] : test::devices())
    for (const std::string& profile : {std::string("lavapipe"), written(turns, "in_turn")}) {
      jit::Options options;
      options.profile = profile, options.scatter = "exact";
      const auto adding = compile(path, options);
      const auto bundle = std::get<bundle::BundleT>(bundle::read(adding));
      const auto& commands = bundle.steps[0]->commands;
      const auto adds = [](const auto& c) { return c->label.ends_with(" add"); };
      CHECK(std::ranges::count(bundle.resources, bundle::Role::Guess, [](const auto& r) { return r->role; }) == 3);
      CHECK(std::ranges::count_if(commands, adds) == 1);
      CHECK(std::ranges::any_of(commands, [](const auto& c) { return c->label.ends_with("_heavy"); }));
      if (name == "swiftshader") continue;  // has no texels of three words
      options.ablate = {"guesses"};
      const auto alone = compile(path, options);
      CHECK(std::ranges::count_if(std::get<bundle::BundleT>(bundle::read(alone)).steps[0]->commands, adds) == 3);
      auto program = must(runtime::Program::load(device, adding)), apart = must(runtime::Program::load(device, alone));
      auto reference = must(jit::ReferenceProgram::load(adding));
      for (const float factor : {1.0F, 1.0F, 3e4F, INFINITY, 1e-30F, NAN, 0.0F, -2.5F, 1.0F}) {
        INFO(name << ", " << profile << ", factor " << factor);
        auto fresh = must(runtime::Program::load(device, adding));
        const auto found = once(program, factor);
        CHECK(same_bits(found, once(fresh, factor)));
        CHECK(same_bits(found, once(apart, factor)));
        if (!std::isfinite(factor)) continue;
        const auto truth = once(reference, factor);
        for (size_t k = 0; k < found.size(); ++k) CHECK(distance(found[k], truth[k]) <= kTolerance);
      }
    }
}

// Sums that are read at each of few elements, by a scatter that is listed. It leaves the exponents that the next run
// guesses, also where its first element is not listed.
TEST_CASE("a listed scatter reads sums as they are") {
  const auto path = (std::filesystem::path(DR_BUILD_DIR) / "read_sums_test.dr").string();
  std::ofstream(path) << R"(edition 1;
input at : ivec2[W, H];
input scale : float[W, H];
input factor : float;
param tone : float[K];
let lit = if scale > 0.2005 { tone.at(at.x) * scale * tone.at(at.y) } else { 0.0 };
let seen = lit.at((at * 3 + 1) % ivec2(W, H)) * factor;
let error = sum(if scale < 0.9005 { seen * seen } else { 0.0 });
step run { tone <- tone - 0.001 * grad(error, tone); output error; }
)";
  constexpr int kWidth = 40, kHeight = 33, kTones = 50;
  std::mt19937 random(5);
  std::vector<int32_t> at;
  std::vector<float> scale, tone;
  for (int k = 0; k < kWidth * kHeight; ++k) {
    for (int c = 0; c < 2; ++c) at.push_back(static_cast<int32_t>(random() % kTones));
    scale.push_back(k == 0 ? 0.0F : static_cast<float>(random() % 1000) / 1000.0F);
  }
  for (int k = 0; k < kTones; ++k) tone.push_back(static_cast<float>(random() % 1000) / 1000.0F);
  const auto once = [&](auto& program, float factor) {
    must(program.bind("at", Array::from_ints(at, 2, kWidth, kHeight)));
    must(program.bind("scale", Array::from_floats(scale, 1, kWidth, kHeight)));
    must(program.bind("factor", Array::from_floats(std::span(&factor, 1))));
    must(program.bind("tone", Array::from_floats(tone)));
    must(program.run("run"));
    return std::vector<Array>{must(program.leaf("tone"))};
  };
  for (const auto& [name, device] : test::devices())
    for (const std::string& profile : {std::string("lavapipe"), narrow()}) {
      jit::Options options;
      options.profile = profile, options.scatter = "exact";
      const auto guessing = compile(path, options);
      const auto bundle = std::get<bundle::BundleT>(bundle::read(guessing));
      // Neither the sums of pixels nor those of tones become floats in a dispatch of their own.
      CHECK(std::ranges::none_of(bundle.steps[0]->commands,
                                 [](const auto& c) { return c->label.find("resolve") != std::string::npos; }));
      if (profile == "lavapipe" && !runtime::Program::load(device, guessing)) continue;
      options.ablate = {"guesses"};
      auto program = must(runtime::Program::load(device, guessing)),
           apart = must(runtime::Program::load(device, compile(path, options)));
      auto reference = must(jit::ReferenceProgram::load(guessing));
      for (const float factor : {1.0F, 1.0F, 1e3F, 1e3F, INFINITY, 1e-15F, NAN, 0.0F, -2.5F, 1.0F}) {
        INFO(name << ", factor " << factor);
        auto fresh = must(runtime::Program::load(device, guessing));
        const auto found = once(program, factor);
        CHECK(same_bits(found, once(fresh, factor)));
        CHECK(same_bits(found, once(apart, factor)));
        if (std::isfinite(factor)) CHECK(distance(found[0], once(reference, factor)[0]) <= kTolerance);
      }
    }
}

// Where lanes take turns, a heavy branch has a dispatch of its own, and what it scatters is added there: by guesses, of
// which the run itself says whether they were wrong. The largest contributions go up and down from run to run, each
// sum's for itself, and some runs add nothing to one of them, or to none.
TEST_CASE("what a heavy branch adds in its own dispatch is what a first run adds, whatever was guessed before") {
  const auto path = (std::filesystem::path(DR_BUILD_DIR) / "scatter_heavy_test.dr").string();
  std::ofstream(path) << R"(edition 1;
input place : ivec2[W, H];
input x : vec2[W, H];
input factor : vec3;
input from : float;
param tone : vec2[T] = vec2(1.5);
param glow : float[R] = 0.5;
param runs : int = 0;
fn far(p: vec2, k: int) -> float { sin(p.x * float(k)) * exp(-p.y) / (1.0 + float(k) * abs(p.x)) }
let now = x * float(1 + runs - runs);
let read = if now.x > from {
  let a = tone.at(place.x) * factor.x * far(now, 1) + tone.at(place.y) * exp(sin(now.y)) * far(now.yx, 2);
  let b = glow.at(place.y) * factor.y * (far(now, 3) + far(now.yx, 4) * cos(now.x) * sqrt(1.0 + now.y * now.y));
  dot(a, vec2(1.0, factor.z)) * b
} else { 0.0 };
let rare = if unlikely(abs(read) > 0.4) {
  let c = tone.at(place.y) * far(now, 5) * exp(sin(now.x)) + tone.at(place.x) * far(now.yx, 6) * sqrt(1.0 + now.x * now.x);
  factor.z * dot(c, vec2(cos(read), exp(-now.x))) * glow.at(place.x) * (far(now, 7) + far(now.yx, 8))
} else { 0.0 };
let error = sum(read * read + rare * rare);
step run {
  runs <- runs + 1;
  output pull = grad(error, tone), share = grad(error, glow);
}
)";
  constexpr int kWidth = 70, kHeight = 41, kTones = 50, kGlows = 9;
  std::mt19937 random(7);
  std::vector<float> x;
  std::vector<int32_t> place;
  for (int k = 0; k < 2 * kWidth * kHeight; ++k) {
    x.push_back(static_cast<float>(random() % 1000) / 1000.0F);
    place.push_back(static_cast<int32_t>(random() % (kTones + 4)) - 2);
  }
  const auto bind = [&](auto& program) {
    must(program.bind("place", Array::from_ints(place, 2, kWidth, kHeight)));
    must(program.bind("x", Array::from_floats(x, 2, kWidth, kHeight)));
    must(program.bind("tone", Array::from_floats(std::vector<float>(size_t{2} * kTones, 1.5F), 2)));
    must(program.bind("glow", Array::from_floats(std::vector<float>(kGlows, 0.5F))));
  };
  const auto once = [&](auto& program, const std::array<float, 3>& factor, float from) {
    must(program.bind("factor", Array::from_floats(factor, 3)));
    must(program.bind("from", Array::from_floats(std::span(&from, 1))));
    must(program.run("run"));
    return std::vector<Array>{must(program.output("run", "pull")), must(program.output("run", "share"))};
  };
  for (const auto& [name, device] : test::devices()) {
    jit::Options options;
    options.profile = name, options.scatter = "exact";
    const auto guessing = compile(path, options);
    const auto bundle = std::get<bundle::BundleT>(bundle::read(guessing));
    const auto has = [&](const char* end) {
      return std::ranges::any_of(bundle.resources, [&](const auto& r) { return r->name.ends_with(end); });
    };
    if (name == std::string("lavapipe")) {
      CHECK(has("_groups"));
      CHECK(has("_heavy"));
      CHECK(has("_unlikely"));
      CHECK(!has("_active"));
    }
    auto program = must(runtime::Program::load(device, guessing));
    bind(program);
    std::vector<runtime::Program> others;  // of these, the first guesses nothing
    for (const char* part : {"guesses", "branches"}) {
      options.ablate = {part};
      others.push_back(must(runtime::Program::load(device, compile(path, options))));
      bind(others.back());
    }
    auto reference = must(jit::ReferenceProgram::load(guessing));
    bind(reference);
    for (const std::array<float, 3> factor : {std::array{1.0F, 1.0F, 1.0F},
                                              {1.0F, 1.0F, 1.0F},
                                              {3e4F, 1.0F, 1.0F},
                                              {1e-7F, 1.0F, 1.0F},
                                              {1.0F, 1e12F, 0.0F},
                                              {1.0F, 0.0F, 0.0F},
                                              {1.0F, 2.5F, 1e-3F},
                                              {0.0F, 0.0F, 0.0F},
                                              {INFINITY, 1.0F, 1.0F},
                                              {1.0F, 0.5F, 0.25F},
                                              {1.0F, NAN, 1.0F},
                                              {1.0F, 0.25F, 1.0F}})
      for (const float from : {0.1F, 2.0F}) {
        INFO(name << ", factors " << factor[0] << ", " << factor[1] << ", " << factor[2] << ", from " << from);
        const std::vector<Array> found = once(program, factor, from);
        for (runtime::Program& other : others) CHECK(same_bits(found, once(other, factor, from)));
        const std::vector<Array> truth = once(reference, factor, from);
        const bool finite = std::ranges::all_of(factor, [](float f) { return std::isfinite(f); });
        for (size_t k = 0; finite && k < found.size(); ++k) CHECK(distance(found[k], truth[k]) <= kTolerance);
      }
  }
}
