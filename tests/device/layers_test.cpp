// SPDX-License-Identifier: Apache-2.0
// One program over [W, H, N] for few and many layers: maps, shifts, reductions over layers, a raster with a view a
// layer, and gradients of what the views share and of what each has for itself. Lowerings of a device agree bit for
// bit, and the device with the evaluator that is given its faces.
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <map>

#include "runtime/jit/jit.h"
#include "runtime/jit/reference_program.h"
#include "runtime/runtime.h"
#include "tests/catch.h"
#include "tests/device/compile.h"
#include "tests/device/devices.h"

using namespace dr;
using io::Array;
using test::must;

namespace {

const char* const kProgram = R"(edition 1;

param corner : vec2[V];           // around the middle of the pictures, in pixels
param moved  : vec2[1, 1, N] = 0.0;
input turn   : vec2[1, 1, N];     // of each view: cosine and sine
input face   : ivec3[F];
input a      : float[W, H, N];

let layer = float(coord(1, 1, N).z);
let mapped = 1.5 * a - exp(-a) + 0.01 * layer;
let shifted = shift(mapped, 1, -1) + shift(mapped, -2, 0);
let beside = mapped.at(coord(W, H).yx);

let turned = vec2(turn.x * corner.x - turn.y * corner.y, turn.y * corner.x + turn.x * corner.y);
let place = turned + moved + 0.5 * vec2(float(W), float(H));   // vec2[V, 1, N]

struct Triangle { a: vec2; b: vec2; c: vec2; z: float; }

let seen = raster(F, W, H, N, nearest = 2) {
  setup(f) -> Triangle {
    let i = face.at(f);
    Triangle(place.at(i.x), place.at(i.y), place.at(i.z), float(f))
  }
  corner(s, k) -> vec2 { [s.a, s.b, s.c][k] }
  depth(s, p) -> float { 0.9 - 0.2 * s.z }
}[0];

fn shade(f: int, p: vec2) -> float {
  let i = face.at(f);
  let (a, b) = (p - place.at(i.x), p - place.at(i.z));
  1.0 / (1.0 + 0.05 * dot(a, a) + 0.02 * dot(b, b))
}

let p = vec2(coord(W, H).xy) + 0.5;
let picture = if seen.face >= 0 { a * shade(seen.face, p) } else { 0.0 };
let loss = sum(picture) / float(W * H);

step go {
  output mapped, shifted, beside, first = mapped.layer(0), last = mapped.layer(N - 1),
         total = sum(shifted, over = layers), highest = max(mapped, over = layers), least = min(shifted, over = (x, layers)),
         means = mean(a, over = (x, y)), all = mean(shifted),
         face = seen.face, picture, blended = mean(picture, over = layers), loss,
         to_each = grad(loss, moved), to_shared = grad(loss, corner);
}

step fit { moved <- moved - 0.1 * grad(loss, moved); corner <- corner - 0.01 * grad(loss, corner); output picture; }
)";

constexpr int kWidth = 13, kHeight = 9;

template <class P>
void bind(P& program, int layers) {
  std::vector<float> values, turns;
  for (int l = 0; l < layers; ++l) {
    turns.push_back(std::cos(0.7f * static_cast<float>(l)));
    turns.push_back(std::sin(0.7f * static_cast<float>(l)));
    for (int k = 0; k < kWidth * kHeight; ++k)
      values.push_back(0.5f + 0.5f * std::sin(static_cast<float>(k * k % 101 + 3 * l)));
  }
  const std::vector<float> corners{-4.3f, -3.1f, 4.6f, -2.2f, 0.4f, 4.1f, 4.7f, 3.6f};
  const std::vector<int32_t> faces{0, 1, 2, 3, 2, 1};
  must(program.bind("corner", Array::from_floats(corners, 2)));
  must(program.bind("turn", Array::from_floats(turns, 2, 1, 1, layers)));
  must(program.bind("face", Array::from_ints(faces, 3)));
  must(program.bind("a", Array::from_floats(values, 1, kWidth, kHeight, layers)));
}

struct Answer {
  std::map<std::string, Array> values;
  std::vector<std::vector<Array>> rasters;  // of the first run
};

const char* const kOutputs[] = {"mapped", "shifted", "beside", "first",   "last",    "total", "highest", "least",
                                "means",  "all",     "face",   "picture", "blended", "loss",  "to_each", "to_shared"};

Answer run(runtime::Program& program, int layers) {
  Answer answer;
  bind(program, layers);
  must(program.run("go"));
  for (const char* name : kOutputs) answer.values.emplace(name, must(program.output("go", name)));
  answer.rasters = must(program.rasters("go"));
  must(program.run("fit", 3));
  answer.values.emplace("fitted", must(program.output("fit", "picture")));
  for (const char* leaf : {"moved", "corner"}) answer.values.emplace(leaf, must(program.leaf(leaf)));
  return answer;
}

void check_lively(const Answer& answer, int layers) {
  const Array& face = answer.values.at("face");
  REQUIRE(face.layers == layers);
  const auto faces = face.as<int32_t>();
  const size_t size = size_t{kWidth} * kHeight;
  for (size_t l = 0; l < static_cast<size_t>(layers); ++l) {
    int seen[3] = {}, changed = 0;
    for (size_t k = 0; k < size; ++k) {
      ++seen[faces[l * size + k] + 1];
      changed += faces[l * size + k] != faces[k];
    }
    INFO("layer " << l);
    CHECK(seen[0] > 10);
    CHECK(seen[1] > 5);
    CHECK(seen[2] > 5);
    CHECK((l == 0 || changed > 0));
  }
}

void check_against_evaluator(const Answer& answer, const std::vector<uint8_t>& bundle, int layers) {
  auto reference = must(jit::ReferenceProgram::load(bundle));
  bind(reference, layers);
  must(reference.freeze("go", answer.rasters));
  must(reference.run("go"));
  for (const char* name : kOutputs) {
    const auto found = answer.values.at(name).to_doubles(), expected = must(reference.output("go", name)).to_doubles();
    REQUIRE(found.size() == expected.size());
    double most = 0;
    for (size_t k = 0; k < found.size(); ++k) {
      REQUIRE(std::isfinite(found[k]));
      most = std::max(most, std::fabs(found[k] - expected[k]) / std::max(1.0, std::fabs(expected[k])));
    }
    INFO(name << " differs by " << most);
    CHECK(most <= 1e-5);
  }
}

}  // namespace

TEST_CASE("programs over layers give one answer, however many there are") {
  const std::string path = (std::filesystem::path(DR_BUILD_DIR) / "layers.dr").string();
  std::ofstream(path) << kProgram;
  for (const auto& [name, device] : test::devices()) {
    struct Road {
      const char *lower, *raster, *pack;
    };
    std::vector<std::vector<uint8_t>> bundles;
    for (const Road& road : {Road{"fragment", "hardware", "fused"}, {"compute", "compute", "fused"}}) {
      jit::Options options;
      options.profile = name;
      options.lower = road.lower;
      options.raster = road.raster;
      options.pack = road.pack;
      bundles.push_back(test::compile(path, options));
    }
    for (const int layers : name == "lavapipe" ? std::vector<int>{1, 6, 8, 49} : std::vector<int>{1, 8}) {
      INFO(name << ", " << layers << " layers");
      auto fragment = must(runtime::Program::load(device, bundles[0]));
      auto compute = must(runtime::Program::load(device, bundles[1]));
      const Answer a = run(fragment, layers), b = run(compute, layers);
      for (const auto& [output, array] : a.values) {
        INFO(output);
        CHECK(array.kind == b.values.at(output).kind);
        CHECK(array.bytes == b.values.at(output).bytes);
      }
      check_lively(a, layers);
      check_against_evaluator(a, bundles[0], layers);
      for (const std::string& message : device.validation_messages()) FAIL("validation: " << message);
    }
  }
}
