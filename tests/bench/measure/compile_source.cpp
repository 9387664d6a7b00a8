// SPDX-License-Identifier: Apache-2.0
#include <algorithm>

#include "tests/bench/measure/compile_input.h"

namespace dr::bench {
namespace {

// One part of the program; `#` stands for its number.
constexpr std::string_view kPart = R"(
// ---- Part # ---------------------------------------------------------------------------------------------------------

param albedo# : vec3[A, B] = vec3(0.5);   // sought: a texture
param pose# : vec3;                       // and where the light stands
input photo# : vec3[W, H, N];

/// A surface as the light sees it.
struct Surface# {
  point: vec3;
  normal: vec3;
  roughness: float = 0.5;
  fn facing(self, direction: vec3) -> float { max(dot(self.normal, direction), 0.0) }
}

/// The weights of the corners at a pixel; none is negative inside.
fn weights#(a: vec2, b: vec2, c: vec2, p: vec2) -> vec3 {
  let area = cross2(b - a, c - a);
  vec3(cross2(b - p, c - p), cross2(c - p, a - p), cross2(a - p, b - p)) / area
}

/// A microfacet lobe, by its three factors.
fn lobe#(s: Surface#, view: vec3, light: vec3) -> float {
  let half = normalize(view + light);
  let alpha = s.roughness * s.roughness;
  let c = s.facing(half);
  let d = c * c * (alpha * alpha - 1.0) + 1.0;
  let k = alpha / 2.0;
  let shadowing = s.facing(light) / (s.facing(light) * (1.0 - k) + k);
  let fresnel = 0.04 + 0.96 * pow(1.0 - saturate(dot(half, view)), 5.0);
  alpha * alpha / (3.14159 * d * d + 1e-6) * shadowing * fresnel
}

/// The mean of the neighbours, the border repeated.
fn soften#(image: vec3[W, H]) -> vec3[W, H] {
  let p = coord(W, H).xy;
  var sum = vec3(0.0);
  for dy in -1..2 {
    for dx in -1..2 { sum = sum + image.at(clamp(p + ivec2(dx, dy), ivec2(0), ivec2(W - 1, H - 1))); }
  }
  sum / 9.0
}

let face_of# = (coord(W, H).x + # * coord(W, H).y) % F;
let corner# = face.at(face_of#);
let bary# = {
  let p = vec2(coord(W, H).xy) + 0.5;
  weights#(position.at(corner#.x).xy, position.at(corner#.y).xy, position.at(corner#.z).xy, p)
};

let shade# = if bary#.x >= 0.0 && bary#.y >= 0.0 {
  let a = position.at(corner#.x);
  let b = position.at(corner#.y);
  let c = position.at(corner#.z);
  let s = Surface#(a * bary#.x + b * bary#.y + c * bary#.z, normalize(cross(b - a, c - a)));
  let light = normalize(pose# - s.point);
  s.facing(light) + lobe#(s, vec3(0.0, 0.0, 1.0), light)
} else {
  0.0
};

let texel# = texture.bilinear(soften#(albedo#), saturate(bary#.xy));
let occluded# = reduce(sum, i in 0..8) { saturate(dot(position.at(i), pose#)) } / 8.0;
let picture# = camera_gain * shade# * texel# * (1.0 - 0.5 * occluded#);
let uneven# = scatter_add(face.x, position.at(face.y) - position.at(face.x), V);
let loss# = loss.l2(picture#, photo#) + 0.1 * mean(dot(uneven#, uneven#));

step fit# {
  minimize loss# over albedo#, pose# with optim.adam(rate = 0.01);
  camera_gain <- camera_gain - 0.1 * grad(loss#, camera_gain);
  output loss = loss#, picture = picture#;
}
)";

constexpr std::string_view kHead = R"(edition 1;

/// A large program.

import std.loss;
import std.optim;
import std.texture;

param position : vec3[V];
param camera_gain : float[1, 1, N] = 1.0;
input face : ivec3[F];

fn cross2(a: vec2, b: vec2) -> float { a.x * b.y - a.y * b.x }
)";

}  // namespace

std::string generated_source(size_t lines) {
  const auto lines_of = [](std::string_view text) {
    return static_cast<size_t>(std::count(text.begin(), text.end(), '\n'));
  };
  std::string source(kHead);
  for (size_t part = 1; lines_of(kHead) + part * lines_of(kPart) <= lines; ++part) {
    for (const char c : kPart) {
      if (c == '#') {
        source += std::to_string(part);
      } else {
        source += c;
      }
    }
  }
  return source;
}

}  // namespace dr::bench
