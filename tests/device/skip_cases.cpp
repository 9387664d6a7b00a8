// SPDX-License-Identifier: Apache-2.0
#include "tests/device/skip_cases.h"

#include <cmath>

namespace dr::skip_test {

using io::Array;

Array floats(std::vector<float> values, int64_t width, int64_t height) {
  return Array::from_floats(values, 1, width, height);
}

namespace {

Array ramp(int64_t width, int64_t height = 1, float from = 0.1f) {
  std::vector<float> values;
  for (int64_t k = 0; k < width * height; ++k) values.push_back(from + 0.01f * static_cast<float>(k % 97));
  return floats(values, width, height);
}

// `count` ones, then zeros.
Array ones(int64_t width, int64_t height, int64_t count) {
  std::vector<float> values(static_cast<size_t>(width * height), 0.0f);
  std::fill_n(values.begin(), count, 1.0f);
  return floats(values, width, height);
}

Array sky(float scale) {
  std::vector<float> values;
  for (int k = 0; k < 32 * 16 * 3; ++k) values.push_back(scale * (0.1f + 0.01f * static_cast<float>(k % 97)));
  return Array::from_floats(values, 3, 32, 16);
}

// 6 places of an image, one behind the other.
Array places(int first) {
  std::vector<int> out;
  for (int k = first; k < first + 6; ++k) out.insert(out.end(), {k % 8, k / 8 + 2});
  return Array::from_ints(out, 2, 6);
}

// Places at a height of a picture.
Array row_at(float y) {
  std::vector<float> out;
  for (int k = 0; k < 4; ++k) out.insert(out.end(), {0.1f + 0.02f * static_cast<float>(k), y});
  return Array::from_floats(out, 2, 4);
}

// A sphere: `around` vertices on each of `rings` rings, and two poles.
Array sphere(int around, int rings, float radius) {
  std::vector<float> out{0, radius, 0, 0, -radius, 0};
  for (int r = 1; r <= rings; ++r)
    for (int k = 0; k < around; ++k) {
      const double theta = 3.14159265 * r / (rings + 1), phi = 6.2831853 * k / around;
      out.push_back(radius * static_cast<float>(std::sin(theta) * std::sin(phi)));
      out.push_back(radius * static_cast<float>(std::cos(theta)));
      out.push_back(radius * static_cast<float>(std::sin(theta) * std::cos(phi)));
    }
  return Array::from_floats(out, 3, 2 + around * rings);
}

Array sphere_faces(int around, int rings) {
  std::vector<int> out;
  const auto at = [&](int ring, int k) { return 2 + ring * around + k % around; };
  for (int k = 0; k < around; ++k) {
    out.insert(out.end(), {0, at(0, k), at(0, k + 1), 1, at(rings - 1, k + 1), at(rings - 1, k)});
    for (int r = 0; r + 1 < rings; ++r)
      out.insert(out.end(), {at(r, k), at(r + 1, k), at(r + 1, k + 1), at(r, k), at(r + 1, k + 1), at(r, k + 1)});
  }
  return Array::from_ints(out, 3, 2 * around * rings);
}

// 10 of 256 pixels read a texel; later 25 do.
// Which pixels read a texel cannot be computed from it, so that its gradient is a scatter.
const char* const kStepsTexels = R"(
import std.optim;
param texel : float[64, 64] = 0.9;
input place : ivec2[6];
let color = texel.at(place);
let error = sum((color - 0.3) * (color - 0.3));
step go {
  minimize error over texel with optim.adam(rate = 0.01);
  texel <- optim.to_range(texel);
  output error, color;
})";

const char* const kStepsPyramid = R"(
import std.optim;
import std.texture;
param texel : float[64, 64] = 0.9;
input place : vec2[4];
let color = texture.trilinear(texture.pyramid(texel, 3), place, 0.5);
let error = sum((color - 0.3) * (color - 0.3));
step go {
  minimize error over texel with optim.adam(rate = 0.01);
  output error, color;
})";

// As kStepsPyramid, of a texture whose size data says: loops find what a texel gathers.
const char* const kStepsPyramidOfData = R"(
import std.optim;
import std.texture;
param texel : float[W, H];
input place : vec2[4];
let color = texture.trilinear(texture.pyramid(texel, 3), place, 0.5);
let error = sum((color - 0.3) * (color - 0.3));
step go {
  minimize error over texel with optim.adam(rate = 0.01);
  output error, color;
})";

const char* const kReadsTexels = R"(
param texel : float[T];
input seen : float[16, 16];
let p = coord(16, 16);
let color = if seen > 0.5 { texel.at((p.x * p.y) % 16) } else { 0.0 };
let error = sum((color - 0.3) * (color - 0.3));
step go { texel <- texel - 0.01 * grad(error, texel); output error, color; })";

}  // namespace

std::vector<Case> cases() {
  return {
      {.id = "dead",
       // The gradient of `b` is asked for and then needed by no step.
       .text = R"(
const frozen = true;
param a : float[W] = 0.5;
param b : float[W] = 0.25;
input x : float[W];
let error = sum(sin(a * x) * exp(b));
let (to_a, to_b) = grad(error, (a, b));
step go { a <- a - 0.1 * to_a; b <- const if frozen { b } else { b - 0.1 * to_b }; output error; })",
       .bound = {{"x", ramp(8)}},
       .define = "frozen=false",
       .with = {14, 3},
       .without = {18, 0},
       .woken = {17, 1}},
      // Halvings of a texture that no pixel reads are not made.
      {.id = "dead",
       .text = R"(
import std.texture;
const level = 0.0;
input image : float[32, 32];
step go { output y = texture.trilinear(texture.pyramid(image, 5), vec2(coord(8, 8).xy) / 8.0, level); })",
       .bound = {{"image", ramp(32, 32)}},
       .define = "level=1.5",
       .with = {57, 390},
       .without = {166, 0},
       .woken = {151, 272}},
      // The matt layer of what is all metal.
      {.id = "dead",
       .text = R"(
import std.light;
import std.material;
const metallic = 1.0;
input normal : vec3[8];
let m = material.Material(base = vec3(0.9, 0.6, 0.3), metallic = metallic, roughness = 0.4);
let lamp = light.directional(vec3(0.0, 0.6, 0.8), vec3(3.0));
step go { output y = material.shade(m, normal, lamp, vec3(0.0, 0.0, 1.0), matt = material.burley); })",
       .bound = {{"normal", Array::from_floats(std::vector<float>(24, 0.5773503f), 3, 8)}},
       .define = "metallic=0.5",
       .with = {65, 93},
       .without = {128, 0},
       .woken = {106, 39}},
      {.id = "zero",
       // A term of weight 0: its gradient is zero whatever `a` is.
       .text = R"(
const weight = 0.0;
param a : float[W] = 0.5;
input x : float[W];
let error = sum(sin(a * x)) + weight * sum(exp(a));
step go { a <- a - 0.1 * grad(error, a); output error; })",
       .bound = {{"x", ramp(8)}},
       .define = "weight=0.5",
       .with = {15, 2},
       .without = {17, 0},
       .woken = {17, 0}},
      {.id = "fold",
       // The gradient is the product of two constants.
       .text = R"(
const scale = 3.0;
param a : float[W] = 0.5;
input x : float[W];
let error = scale * (1.5 * sum(a * x));
step go { a <- a - 0.1 * grad(error, a); output error; })",
       .bound = {{"x", ramp(8)}},
       .define = "scale=5.0",
       .with = {13, 1},
       .without = {13, 0},
       .woken = {13, 1}},
      {.id = "share",
       .text = R"(
const other = false;
input x : float[W];
let a = sin(x) * exp(x);
let b = const if other { cos(x) } else { sin(x) } * exp(x);
step go { output y = a + b * b; })",
       .bound = {{"x", ramp(8)}},
       .define = "other=true",
       .with = {6, 3},
       .without = {9, 0},
       .woken = {8, 1}},
      {.id = "layers",
       .text = R"(
const more = 0.0;
param a : float[W] = 0.5;
input strength : float;
input x : float[W];
let factor = (strength + more) * x;
let y = const if known_zero(factor) { a * x } else { factor * exp(a) + a * x };
step go { a <- a - 0.1 * grad(sum(y), a); output y; })",
       .bound = {{"strength", floats({0}, 1)}, {"x", ramp(8)}},
       .define = "more=1.0",
       .with = {0, 1},
       .without = {1, 0},
       .woken = {1, 0},
       .known = {{"strength", {0}}}},
      // A dark lamp, and a material that mirrors nothing, under another lamp. A gradient reaches texels, normals and
      // roughness.
      {.id = "layers",
       .text = R"(
import std.light;
import std.material;
const more = 0.0;
param base : vec3[16] = 0.5;
param bend : vec2[16] = 0.1;
param rough : float[16] = 0.4;
input metallic : float;
input specular : float;
input lamp : vec3;
let normal = normalize(vec3(bend, 1.0));
let m = material.Material(base = base, metallic = metallic, roughness = rough, specular = specular);
let to_camera = vec3(0.0, 0.0, 1.0);
let first = light.directional(vec3(0.3, 0.4, 1.0), vec3(3.0));
let second = light.point(vec3(1.0, 2.0, 2.0), vec3(normal.xy, 0.0), lamp + more);
let color = material.shade(m, normal, first, to_camera) + material.shade(m, normal, second, to_camera);
let error = sum(dot(color - 0.2, color - 0.2));
step go {
  base <- base - 0.01 * grad(error, base);
  bend <- bend - 0.01 * grad(error, bend);
  rough <- rough - 0.01 * grad(error, rough);
  output color, error;
})",
       .bound = {{"metallic", floats({0}, 1)},
                 {"specular", floats({0}, 1)},
                 {"lamp", Array::from_floats(std::vector<float>{0, 0, 0}, 3, 1)}},
       .define = "more=1.0",
       .with = {2, 2},
       .without = {6, 0},
       .woken = {4, 2},
       .known = {{"metallic", {0}}, {"specular", {0}}, {"lamp", {0}}}},
      {.id = "slots",
       // Each blur is read beside its own place, so it is stored.
       .text = R"(
const times = 5;
input x : float[W, H];
fn blur(x: float[W, H]) -> float[W, H] { 0.5 * shift(x, 1, 0) + 0.5 * shift(x, 0, 1) }
let y = { var y = x; for k in 0..times { y = blur(y); } y };
step go { output y; })",
       .bound = {{"x", ramp(8, 8)}},
       .define = "times=3",
       .with = {4, 2},
       .without = {6, 0},
       .woken = {4, 0}},
      // Two dispatches by lists; one, where the pass that lists does the first itself.
      {.id = "active",
       .text = kReadsTexels,
       .bound = {{"seen", ones(16, 16, 10)}, {"texel", ones(16, 1, 16)}},
       .leaf = "seen",
       .data = ones(16, 16, 25),
       .with = {20, 492},
       .without = {0, 0},
       .woken = {50, 462},
       .scatter = "exact",
       .only_on = "lavapipe"},
      {.id = "active",
       .text = kReadsTexels,
       .bound = {{"seen", ones(16, 16, 10)}, {"texel", ones(16, 1, 16)}},
       .leaf = "seen",
       .data = ones(16, 16, 25),
       .with = {10, 246},
       .without = {0, 0},
       .woken = {25, 231},
       .scatter = "exact",
       .only_on = "swiftshader"},
      // 6 of 64 texels are read; later 6, of which 3 are others. Those that were keep a memory and go on.
      {.id = "stepped",
       .text = R"(
import std.optim;
param texel : float[U, V];
input place : ivec2[6];
let color = texel.at(place);
let error = sum((color - 0.3) * (color - 0.3));
step go {
  minimize error over texel with optim.adam(rate = 0.01);
  texel <- optim.to_range(texel);
  output error, color;
})",
       .bound = {{"place", places(0)}, {"texel", ones(8, 8, 64)}},
       .leaf = "place",
       .data = places(3),
       .with = {12, 116},
       .without = {0, 0},
       .woken = {18, 110},
       .scatter = "rows"},
      // By exact sums, which wake the texels that they add to for the first time: then nothing is listed anew. Few
      // texels would be summed in bins.
      {.id = "stepped",
       .text = kStepsTexels,
       .bound = {{"place", places(0)}},
       .leaf = "place",
       .data = places(3),
       .with = {6, 4090},
       .without = {0, 0},
       .woken = {9, 4087},
       .scatter = "exact",
       .only_on = "lavapipe"},
      // A GPU marks blocks of 64: the first, which leaves what the next run guesses, and those of one row, later of
      // two.
      {.id = "stepped",
       .text = kStepsTexels,
       .bound = {{"place", places(0)}},
       .leaf = "place",
       .data = places(3),
       .with = {128, 3968},
       .without = {0, 0},
       .woken = {192, 3904},
       .scatter = "exact",
       .as_gpu = true},
      {.id = "stepped",
       .text = kStepsTexels,
       .bound = {{"place", places(0)}},
       .leaf = "place",
       .data = places(3),
       .with = {64, 4032},
       .without = {0, 0},
       .woken = {128, 3968},
       .scatter = "atomic",
       .only_on = "lavapipe",
       .as_gpu = true},
      // A pyramid, whose levels hand down what they get: four rows, later eight, and one beside each four that looks at
      // what is not its own; a GPU marks the first, too.
      {.id = "stepped",
       .text = kStepsPyramid,
       .bound = {{"place", row_at(0.1f)}},
       .leaf = "place",
       .data = row_at(0.6f),
       .with = {384, 3712},
       .without = {0, 0},
       .woken = {704, 3392},
       .scatter = "exact",
       .as_gpu = true},
      {.id = "stepped",
       .text = kStepsPyramid,
       .bound = {{"place", row_at(0.1f)}},
       .leaf = "place",
       .data = row_at(0.6f),
       .with = {320, 3776},
       .without = {0, 0},
       .woken = {640, 3456},
       .scatter = "exact",
       .only_on = "lavapipe"},
      // Loops look at what is their own alone; a GPU that guesses exponents marks the first block, too.
      {.id = "stepped",
       .text = kStepsPyramidOfData,
       .bound = {{"place", row_at(0.1f)}, {"texel", ones(64, 64, 4096)}},
       .leaf = "place",
       .data = row_at(0.6f),
       .with = {320, 3776},
       .without = {0, 0},
       .woken = {576, 3520},
       .scatter = "exact",
       .as_gpu = true},
      {.id = "stepped",
       .text = kStepsPyramidOfData,
       .bound = {{"place", row_at(0.1f)}, {"texel", ones(64, 64, 4096)}},
       .leaf = "place",
       .data = row_at(0.6f),
       .with = {256, 3840},
       .without = {0, 0},
       .woken = {512, 3584},
       .scatter = "exact",
       .only_on = "lavapipe"},
      {.id = "stepped",
       .text = kStepsPyramidOfData,
       .bound = {{"place", row_at(0.1f)}, {"texel", ones(64, 64, 4096)}},
       .leaf = "place",
       .data = row_at(0.6f),
       .with = {256, 3840},
       .without = {0, 0},
       .woken = {512, 3584},
       .scatter = "atomic",
       .only_on = "lavapipe",
       .as_gpu = true},
      {.id = "branches",
       .text = R"(
param tone : float = 1.0;
input seen : float[16, 16];
fn slow(x: float) -> float { sin(exp(sin(x) + cos(3.0 * x))) * exp(cos(x) + sin(exp(cos(7.0 * x)))) }
step go {
  tone <- 2.0 - tone;
  output y = if seen > 0.5 { slow(tone * seen) + slow(2.0 * tone) + slow(3.0 * tone) } else { 0.0 };
})",
       .bound = {{"seen", ones(16, 16, 10)}},
       .leaf = "seen",
       .data = ones(16, 16, 25),
       .with = {10, 246},
       .without = {0, 0},
       .woken = {25, 231},
       .only_on = "lavapipe"},
      // A lamp that reaches no pixel: its cone looks away. Its material is not shaded.
      {.id = "branches",
       .text = R"(
import std.light;
import std.material;
param tone : float = 1.0;
input turn : float;
let p = vec3(vec2(coord(16, 16).xy) / 16.0, 0.0);
let lamp = light.spot(vec3(0.5, 0.5, 2.0), vec3(0.0, 0.0, turn), p, vec3(10.0), outer = 40.0);
let m = material.Material(base = vec3(tone, 0.5, 0.2), metallic = 0.5, roughness = 0.4);
let table = material.energies();
step go {
  tone <- 1.5 - tone;
  output y = material.shade_full(m, vec3(0.0, 0.0, 1.0), lamp, normalize(vec3(0.2, 0.3, 1.0)), table, matt = material.eon);
})",
       .bound = {{"turn", floats({1.0f}, 1)}},
       .leaf = "turn",
       .data = floats({-1.0f}, 1),
       .with = {0, 256},
       .without = {0, 0},
       .woken = {256, 0},
       .only_on = "lavapipe"},
      {.id = "soft",
       // By draws, which the device counts: faces of a sphere's inside are passed over.
       .text = R"(
import std.camera;
import std.hardsoftras;
import std.mesh;
param tone : float = 1.0;
input position : vec3[V];
input face : ivec3[F];
let clip = camera.project(camera.perspective(40.0) * camera.look_at(vec3(0.4, 0.6, 3.0)), tone * position);
let soft = hardsoftras.rasterize(clip, face, 128, 128);
let alpha = hardsoftras.silhouette(soft);
step go { tone <- 2.0 - tone; output alpha, pull = grad(sum(alpha * alpha), position); })",
       .bound = {{"position", sphere(24, 16, 1.0f)}, {"face", sphere_faces(24, 16)}},
       .leaf = "position",
       .data = sphere(24, 16, 0.6f),
       .with = {247776, 0},
       .without = {475344, 0},
       .woken = {241552, 0},
       .raster = "hardware",
       .only_on = "lavapipe"},
      {.id = "cache",
       .text = R"(
param tone : float = 1.0;
input x : float[W];
let slow = sum(sin(exp(x)));
step go { tone <- tone * 0.5 + slow; output slow, twice = tone * 2.0; })",
       .bound = {{"x", ramp(8)}},
       .leaf = "x",
       .data = ramp(8, 1, 0.7f),
       .with = {6, 4},
       .without = {10, 0},
       .woken = {6, 4}},
      // A sky that stands still is filtered once.
      {.id = "cache",
       .text = R"(
import std.environment;
param tone : float = 1.0;
input sky : vec3[W, H];
let levels = environment.prefilter(sky, 3, 16, halvings = 1, depth = 2);
let way = normalize(vec3(vec2(coord(8, 8).xy) - 3.5, 2.0));
step go { tone <- 1.5 - tone; output y = environment.mirrored(levels, way, 0.4 * tone); })",
       .bound = {{"sky", sky(1.0f)}},
       .leaf = "sky",
       .data = sky(2.0f),
       .with = {23, 32},
       .without = {50, 0},
       .woken = {19, 36},
       .only_on = "lavapipe"},
      {.id = "commands",
       .text = R"(
param tone : float = 1.0;
input x : float[W];
step go { tone <- tone * 0.5 + sum(sin(x)); output y = tone * x; })",
       .bound = {{"x", ramp(8)}},
       .leaf = "x",
       .data = ramp(8, 1, 0.7f),
       .with = {3, 2},
       .without = {5, 0},
       .woken = {1, 4}},
      {.id = "pipelines",
       .text = R"(
const factor = 2.0;
input x : float[W];
step go { output y = sum(sin(x)) * factor * x; })",
       .bound = {{"x", ramp(8)}},
       .define = "factor=3.0",
       .with = {0, 2},
       .without = {2, 0},
       .woken = {2, 0},
       .only_on = "lavapipe"},
      {.id = "shaders",
       .text = R"(
const factor = 2.0;
input x : float[W];
step go { output y = sum(cos(x)) * factor * x; })",
       .bound = {{"x", ramp(8)}},
       .define = "factor=3.0",
       .with = {0, 3},
       .without = {3, 0},
       .woken = {1, 2}},
  };
}

}  // namespace dr::skip_test
