// SPDX-License-Identifier: Apache-2.0
// Values that hold more than a binding takes are bound in parts, in several buffers where one is too small: every kind
// of access gives the bits that it gives where they are whole, on every road.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>

#include "runtime/jit/jit.h"
#include "runtime/runtime.h"
#include "tests/catch.h"
#include "tests/device/compile.h"
#include "tests/device/devices.h"
#include "tests/device/in_parts.h"

using namespace dr;
using io::Array;
using runtime::Program;
using test::must;

namespace {

// Maps, reads beside the element and at computed places, sums of all and along axes, loops that carry a state, whole
// numbers, bools and matrices.
const char* const kMaps = R"(edition 1;
param a : vec3[40, 30] = vec3(0.5);
input x : float[40, 30];
input which : int[1200];
state held : mat3[300];
let moved = shift(a, 1, 2) * x + a.xyz;
let far = a.at(ivec2(which.at(coord(40, 30).x * 30 % 1200) % 40, coord(40, 30).y)) + moved;
let walked = fold(i in 0..9, s = far) { s * 0.9 + vec3(x) * 0.1 };
let lit = x > 0.5;
let error = sum(dot(walked - x, walked - x));
let rows = sum(moved, over = x);
step go {
  a <- a - 0.001 * grad(error, a);
  held <- held * 0.5 + mat3(vec3(x.at(ivec2(coord(300).x % 40, 3))), vec3(1.0), vec3(2.0));
  output error, rows, far, lit, most = max(x), least = min(moved), flags = if lit { 1 } else { 0 };
}
)";

// Sums at places that data names: of many elements and few, of floats and whole numbers.
const char* const kScatters = R"(edition 1;
input index : ivec2[2000];
input x : vec2[2000];
param gain : float = 1.0;
param tone : vec3[13, 11] = vec3(1.0);
let own = gain * x;
let one = scatter_add(index.x, own, 300);
let two = scatter_add(index.x, own, 300) + scatter_add(index.y, own.yx, 300);
let counts = scatter_add(ivec2(index.x % 20, index.y / 20), int(gain), 20, 15);
let seen = if own.y > 0.3 { tone.at(ivec2(index.x % 13, index.y % 11)) * own.x } else { vec3(0.0) };
step go {
  gain <- gain + 1.0 - 1.0;
  output one, two, counts, seen = grad(sum(dot(seen, seen)), tone);
}
)";

// A mesh with a texture: rasters, lists of what is seen, exact sums at texels and vertices.
const char* const kMesh = R"(edition 1;
import std.camera;
import std.loss;
import std.raster;
import std.texture;
param texels   : vec3[96, 96] = vec3(0.5);
param position : vec3[V];
input face     : ivec3[F];
input hold     : float;
let view = camera.perspective(40.0) * camera.look_at(vec3(0.0, 0.0, 4.0));
let at = camera.project(view, position);
let hit = raster.rasterize(at, face, 40, 40);
let place = raster.interpolate(hit, position * 0.5 + 0.5).xy;
let color = if hit.face >= 0 { texture.bilinear(texels, place) } else { vec3(0.0) };
let target = vec3(float(coord(40, 40).x) / 40.0, 0.25, 0.75);
let error = loss.l2(color, target);
step go {
  texels <- texels - hold * grad(error, texels);
  position <- position - 0.01 * hold * grad(error, position);
  output error, color;
}
)";

using Values = std::map<std::string, Array>;

Values data_of_maps() {
  std::vector<float> x;
  std::vector<int> which;
  for (int k = 0; k < 1200; ++k) {
    x.push_back(0.001f * static_cast<float>(k * 37 % 1009));
    which.push_back(k * 7 % 1200);
  }
  return {{"x", Array::from_floats(x, 1, 40, 30)}, {"which", Array::from_ints(which, 1, 1200)}};
}

Values data_of_scatters() {
  std::vector<int> index;
  std::vector<float> x;
  for (int k = 0; k < 4000; ++k) {
    index.push_back(k * k % 299);
    x.push_back(0.001f * static_cast<float>(k * 53 % 997) * (k % 3 == 0 ? -1.0f : 1.0f));
  }
  return {{"index", Array::from_ints(index, 2, 2000)}, {"x", Array::from_floats(x, 2, 2000)}};
}

// A sphere: 14 vertices on each of 9 rings, and two poles.
Values data_of_mesh() {
  constexpr int kAround = 14, kRings = 9;
  std::vector<float> position{0, 1, 0, 0, -1, 0};
  for (int r = 1; r <= kRings; ++r)
    for (int k = 0; k < kAround; ++k) {
      const double theta = 3.14159265 * r / (kRings + 1), phi = 6.2831853 * k / kAround;
      position.push_back(static_cast<float>(std::sin(theta) * std::sin(phi)));
      position.push_back(static_cast<float>(std::cos(theta)));
      position.push_back(static_cast<float>(std::sin(theta) * std::cos(phi)));
    }
  std::vector<int> face;
  const auto at = [](int ring, int k) { return 2 + ring * kAround + k % kAround; };
  for (int k = 0; k < kAround; ++k) {
    face.insert(face.end(), {0, at(0, k), at(0, k + 1), 1, at(kRings - 1, k + 1), at(kRings - 1, k)});
    for (int r = 0; r + 1 < kRings; ++r)
      face.insert(face.end(), {at(r, k), at(r + 1, k), at(r + 1, k + 1), at(r, k), at(r + 1, k + 1), at(r, k + 1)});
  }
  return {{"position", Array::from_floats(position, 3, 2 + kAround * kRings)},
          {"face", Array::from_ints(face, 3, 2 * kAround * kRings)},
          {"hold", Array::from_floats(std::vector<float>{1}, 1)}};
}

void bind(Program& program, const Values& data) {
  for (const auto& [leaf, value] : data) must(program.bind(leaf, value));
}

Values results(Program& program) {
  Values out;
  must(program.run("go", 2));
  for (const std::string& name : program.outputs("go")) out["output " + name] = must(program.output("go", name));
  for (const auto& leaf : program.leaves()) out[leaf.name] = must(program.leaf(leaf.name));
  return out;
}

struct Road {
  const char* name;
  const char *lower = "auto", *raster = "auto", *pack = "fused", *scatter = "auto";
};

// A buffer has three bindings' bytes at most, and the host sees no more than one buffer without a copy. What several
// hold comes back as it was given.
void check_buffers(Program& program, const Values& found, int64_t bytes) {
  for (const auto& leaf : program.leaves()) {
    const Array& value = found.at(leaf.name);
    if (static_cast<int64_t>(value.bytes.size()) <= 3 * bytes) continue;
    CHECK_FALSE(must(program.leaf_view(leaf.name)));
    Array other = value;
    std::rotate(other.bytes.begin(), other.bytes.begin() + 4, other.bytes.end());
    must(program.bind(leaf.name, other));
    if (must(program.leaf(leaf.name)).bytes != other.bytes) FAIL_CHECK(leaf.name << " is not what was bound");
  }
}

void check_roads(const char* text, const Values& data, const std::vector<Road>& roads) {
  for (const auto& [device_name, device] : test::devices())
    for (const Road& road : roads) {
      INFO(road.name << " on " << device_name);
      const bool atomic = std::string(road.scatter) == "atomic";
      if (atomic && !device.limits().shader_buffer_float32_atomic_add) continue;
      const auto path = std::filesystem::path(DR_BUILD_DIR) / "parts_test.dr";
      std::ofstream(path) << text;
      jit::Options options;
      options.profile = device_name;
      options.lower = road.lower;
      options.raster = road.raster;
      options.pack = road.pack;
      options.scatter = road.scatter;
      const auto bundle = test::compile(path.string(), options);
      Program whole = must(Program::load(device, bundle, {.cache = false}));
      bind(whole, data);
      const Values expected = results(whole);
      auto [program, bytes] = test::load_in_parts(device, bundle, {"go"}, 1024, [&](Program& p) { bind(p, data); });
      std::printf("%-12s %-24s %lld bytes a binding\n", device_name.c_str(), road.name, static_cast<long long>(bytes));
      const Values found = results(program);
      size_t largest = 0;
      for (const auto& [name, value] : expected) {
        largest = std::max(largest, value.bytes.size());
        if (!atomic && found.at(name).bytes != value.bytes) FAIL_CHECK(name << " differs");
      }
      CHECK(static_cast<int64_t>(largest) > bytes);
      check_buffers(program, found, bytes);
      for (const std::string& message : device.validation_messages()) FAIL("validation: " << message);
    }
}

}  // namespace

TEST_CASE("maps, reads at other places, sums and loops read and write buffers in parts") {
  check_roads(kMaps, data_of_maps(), {{"fused"}, {"an op a pass", "auto", "auto", "naive"}, {"fragments", "fragment"}});
}

TEST_CASE("scatters add to buffers in parts") {
  const char* const a = "auto";
  check_roads(kScatters, data_of_scatters(),
              {{"auto"},
               {"exact", a, a, "fused", "exact"},
               {"rows", a, a, "fused", "rows"},
               {"atomic", a, a, "fused", "atomic"}});
}

TEST_CASE("rasters, textures and lists take buffers in parts") {
  check_roads(kMesh, data_of_mesh(),
              {{"compute raster", "compute", "compute"},
               {"hardware raster", "fragment", "hardware"},
               {"exact sums", "auto", "auto", "fused", "exact"}});
}

TEST_CASE("a buffer beyond what bindings take in all their parts is an error") {
  for (const auto& [name, device] : test::devices()) {
    if (device.limits().max_per_stage_descriptor_storage_buffers > 1000) continue;  // it may have them all
    const auto bundle = test::compile_text(
        "parts_test.dr", "edition 1;\nparam a : float[N] = 0.5;\nstep go { a <- a * sin(a); }\n", name);
    Program program = must(Program::load(device, bundle, {.buffer_limit = 256}));
    must(program.bind_symbol("N", 1 << 20));
    const auto refused = program.run("go");
    REQUIRE_FALSE(refused);
    INFO(refused.error());
    CHECK(refused.error().find("buffers beyond its limit of bytes are bound in parts") != std::string::npos);
  }
}
