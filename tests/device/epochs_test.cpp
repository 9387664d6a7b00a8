// SPDX-License-Identifier: Apache-2.0
// Rasters whose entries are cleared once in several runs (compiler/backend/lowering/clear_by_epochs.h) show what those
// do that are cleared in each: faces that move away, ranks behind others, pictures of a raster that stands still, views
// between runs, and runs that begin anew, for compute shaders and for fragment shaders that read them.
#include <algorithm>
#include <filesystem>
#include <fstream>

#include "compiler/backend/bundle/bundle.h"
#include "compiler/target/profile.h"
#include "runtime/jit/jit.h"
#include "runtime/runtime.h"
#include "tests/catch.h"
#include "tests/device/compile.h"
#include "tests/device/devices.h"

using namespace dr;
using io::Array;
using test::must;

namespace {

// Faces of several sizes go around, each on a way of its own, over others and out of the picture.
const char* const kText = R"(edition 1;
input corner : vec3[F, 3];
param moved : float = 0.0;
param still : float = 0.0;
struct Corners { a: vec3; b: vec3; c: vec3; }
let seen = raster(F, 48, 40, 2, nearest = 3) {
  setup(f) -> Corners {
    let way = vec3(cos(moved * float(f + 1)), sin(moved * float(f + 2)), 0.001 * float(f)) * vec3(30.0, 30.0, 1.0);
    Corners(corner.at(ivec2(f, 0)) + way, corner.at(ivec2(f, 1)) + way, corner.at(ivec2(f, 2)) + way)
  }
  corner(s, c) -> vec2 { [s.a.xy, s.b.xy, s.c.xy][c] }
  depth(s, p) -> float { s.a.z + 0.001 * p.x }
  tag(s, p) -> int { int(p.y) % 13 }
};
let fixed = raster(F, 48, 40) {
  setup(f) -> Corners { Corners(corner.at(ivec2(f, 0)), corner.at(ivec2(f, 1)), corner.at(ivec2(f, 2))) }
  corner(s, c) -> vec2 { [s.a.xy, s.b.xy, s.c.xy][c] }
  depth(s, p) -> float { s.a.z }
}[0];
let first = vec3(float(seen[0].face), float(seen[1].face), float(seen[2].face));
let second = vec3(float(seen[0].tag), float(seen[1].tag), float(seen[2].tag));
let right = shift(seen[1].face, 1, 0);
step move {
  output first, second, beside = float(right);
  moved <- moved + 0.07;
}
step stand {
  output shade = if fixed.face >= 0 { float(fixed.face) + still } else { -1.0 };
  still <- still + 1.0;
}
)";

}  // namespace

TEST_CASE("entries of earlier runs are none") {
  const std::filesystem::path folder = DR_BUILD_DIR;
  auto gpu = std::get<target::Profile>(target::load_profile("lavapipe"));
  gpu.subgroup_size = 32;
  gpu.lanes_in_turn = false;
  const auto profile = (folder / "epochs_test.json").string();
  std::ofstream(profile) << target::write_profile(gpu);
  const auto path = (folder / "epochs_test.dr").string();
  std::ofstream(path) << kText;
  constexpr int kFaces = 40;
  std::vector<float> corners;  // rows are corners
  for (int corner = 0; corner < 3; ++corner)
    for (int f = 0; f < kFaces; ++f) {
      const auto at = static_cast<float>(f), size = at * at / 40;
      const float places[3][3] = {{at, at * 0.7F, at / 50}, {at + size, at * 0.7F, 0}, {at, at * 0.7F + size, 0}};
      for (const float number : places[corner]) corners.push_back(number);
    }
  for (const auto& [name, device] : test::devices()) {
    if (name != "lavapipe") continue;  // the one that has 64-bit atomics
    std::vector<runtime::Program> programs;
    struct Road {
      const char* lower;
      bool epochs;
    };
    for (const auto& [lower, epochs] : {Road{"compute", true}, Road{"fragment", true}, Road{"compute", false}}) {
      jit::Options options;
      options.profile = profile, options.lower = lower;
      if (!epochs) options.ablate = {"emptying"};
      const auto bytes = test::compile(path, options);
      const auto bundle = std::get<bundle::BundleT>(bundle::read(bytes));
      const auto dated =
          std::ranges::count(bundle.resources, bundle::Role::EpochEntries, [](const auto& r) { return r->role; });
      CHECK(dated == (epochs ? 2 : 0));
      programs.push_back(must(runtime::Program::load(device, bytes)));
      must(programs.back().bind("corner", Array::from_floats(corners, 3, kFaces, 3)));
    }
    // More than two rounds of epochs, some of several runs at once.
    for (int round = 0; round < 3 * bundle::kEpochs; ++round) {
      INFO(name << ", round " << round);
      std::vector<std::vector<Array>> found;
      for (auto& program : programs) {
        must(program.run("move", round % 7 == 3 ? 3 : 1));
        must(program.run("stand", 1));
        found.push_back({must(program.output("move", "first")), must(program.output("move", "second")),
                         must(program.output("move", "beside")), must(program.output("stand", "shade"))});
        for (const char* step : {"move", "stand"})
          for (const std::vector<Array>& raster : must(program.rasters(step)))
            for (const Array& part : raster) found.back().push_back(part);
      }
      REQUIRE(found[0].size() == 4 + 6 + 2);
      for (size_t k = 0; k < found[0].size(); ++k)
        for (size_t road = 1; road < found.size(); ++road) {
          INFO("result " << k << ", road " << road);
          CHECK(found[0][k].bytes == found[road][k].bytes);
        }
    }
    const auto faces = must(programs[0].rasters("move"))[0][4].to_doubles();
    CHECK(std::ranges::count(faces, -1.0) > 0);
    CHECK(std::ranges::count(faces, -1.0) < std::ssize(faces));
  }
}
