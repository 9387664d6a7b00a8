// SPDX-License-Identifier: Apache-2.0
// Faces that read the leaf behind a transform (compiler/backend/pack/transform_at_faces.h) show what they show where
// vertices are transformed first, faces of vertices that are not there among them.
#include <algorithm>
#include <filesystem>
#include <fstream>

#include "compiler/backend/bundle/bundle.h"
#include "compiler/backend/bundle/entries.h"
#include "compiler/target/profile.h"
#include "runtime/jit/jit.h"
#include "runtime/jit/reference_check.h"
#include "runtime/runtime.h"
#include "tests/catch.h"
#include "tests/device/compile.h"
#include "tests/device/devices.h"

using namespace dr;
using io::Array;
using test::must;

TEST_CASE("faces that transform their own corners show the same") {
  const std::filesystem::path folder = DR_BUILD_DIR;
  auto gpu = std::get<target::Profile>(target::load_profile("lavapipe"));
  gpu.subgroup_size = 32;
  gpu.lanes_in_turn = false;
  const auto profile = (folder / "faces_test.json").string();
  std::ofstream(profile) << target::write_profile(gpu);
  const auto path = (folder / "faces_test.dr").string();
  std::ofstream(path) << R"(edition 1;
import std.raster;
param position : vec3[V];
input face : ivec3[F];
input project : mat4;
let hit = raster.rasterize(project * vec4(position, 1.0), face, 32, 32, both_sides = true);
let depth = if hit.face >= 0 { hit.depth } else { -1.0 };
step show { output id = hit.face, depth; position <- position + 0.01 * vec3(float(hit.face.at(ivec2(16)))); }
)";
  const std::vector<float> corners{-0.9F, -0.8F, 0.5F, 0.8F, -0.7F, 0.4F, 0.1F, 0.9F, 0.3F, 0.9F, 0.8F, 0.6F};
  const std::vector<int32_t> faces{0, 1, 2, 1, 3, 2, -1, 1, 2, 0, 4, 2, 0, 5, 3, 0, 0x7fffffff, 1};
  const std::vector<float> project{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0.3F, 0.1F, 0.05F, 0.2F, 1};
  for (const auto& [name, device] : test::devices()) {
    if (name != "lavapipe") continue;  // faces are set up in rasters that have 64-bit atomics
    std::vector<std::vector<Array>> found;
    for (const char* pack : {"fused", "naive"}) {
      jit::Options options;
      options.profile = profile, options.pack = pack;
      const auto bytes = test::compile(path, options);
      const auto bundle = std::get<bundle::BundleT>(bundle::read(bytes));
      const auto reads = [&](const auto& c) {
        return c->label.ends_with("_faces") && std::ranges::any_of(c->bindings, [&](const auto& b) {
                 return bundle.resources[b->resource]->name == "position";
               });
      };
      CHECK(std::ranges::any_of(bundle.steps[0]->commands, reads) == (found.empty()));
      auto program = must(runtime::Program::load(device, bytes));
      must(program.bind("position", Array::from_floats(corners, 3)));
      must(program.bind("face", Array::from_ints(faces, 3)));
      must(program.bind("project", Array::from_floats(project, 16)));
      must(program.run("show", 3));
      found.push_back({must(program.output("show", "id")), must(program.output("show", "depth"))});
    }
    const std::vector<double> ids = found[0][0].to_doubles();
    // A vertex that is not there is 0 in clip space, where no face of it shows; at the leaf's 0 one would.
    for (const double id : {0, 1}) CHECK(std::ranges::find(ids, id) != ids.end());
    for (size_t k = 0; k < 2; ++k) CHECK(found[0][k].bytes == found[1][k].bytes);
  }
}

TEST_CASE("a raster that is asked for presence alone does not say which face, and pictures are the same") {
  const std::filesystem::path folder = DR_BUILD_DIR;
  auto others = std::get<target::Profile>(target::load_profile("lavapipe"));
  others.lanes_in_turn = false;
  const auto profile = (folder / "presence_test.json").string();
  std::ofstream(profile) << target::write_profile(others);
  const auto path = (folder / "presence_test.dr").string();
  std::ofstream(path) << R"(edition 1;
import std.tiles;
input corner : vec3[F, 3];
struct Corners { a: vec3; b: vec3; c: vec3; }
// A depth that is no number is that of no face.
let seen = raster(F, 80, 60, 1) {
  setup(f) -> Corners { Corners(corner.at(ivec2(f, 0)), corner.at(ivec2(f, 1)), corner.at(ivec2(f, 2))) }
  corner(s, c) -> vec2 { [s.a.xy, s.b.xy, s.c.xy][c] }
  keep(s, p) -> bool { p.x + p.y < s.c.z }
  depth(s, p) -> float { sqrt(s.a.z) }
}[0].face;
let here = if seen >= 0 { 1.0 } else { 0.0 };
let beside = if seen.at(coord(80, 60).xy + ivec2(1, 0)) < 0 { 2.0 } else { 3.0 };
let rows = tiles.rows(seen);
let odd = if tiles.bit(rows, coord(80, 60).xy) != (seen < 0) { 1.0 } else { 0.0 };
let ends = tiles.border(rows, 80, 2);
step presence { output here, beside, odd, ends; }
step which { output seen, again = here; }
)";
  std::vector<float> corners;  // of faces of all sizes: rows are corners
  for (int corner = 0; corner < 3; ++corner)
    for (int f = 0; f < 40; ++f) {
      const auto at = static_cast<float>(f), size = at * at / 20;
      const float places[3][3] = {
          {at * 1.5F, at, f % 7 == 3 ? -1.0F : 0.5F}, {at * 1.5F + size, at, 0}, {at * 1.5F, at + size, 90}};
      for (const float number : places[corner]) corners.push_back(number);
    }
  for (const auto& [name, device] : test::devices()) {
    if (name != "lavapipe") continue;  // entries of 64-bit atomics on a device whose lanes take turns
    std::vector<std::vector<Array>> found;
    for (const std::string& compiled_for : {std::string("lavapipe"), profile}) {
      jit::Options options;
      options.profile = compiled_for;
      const auto bytes = test::compile(path, options);
      auto program = must(runtime::Program::load(device, bytes));
      must(program.bind("corner", Array::from_floats(corners, 3, 40, 3)));
      auto check = must(jit::ReferenceCheck::load(bytes));
      must(check.bind_symbol("F", 40));
      CHECK(must(check.run(program, "presence", 1)).differ.empty());
      const auto faces = must(program.rasters("presence"))[0][0].to_doubles();
      const auto some = std::ranges::count(faces, bundle::kSomeFace), none = std::ranges::count(faces, -1);
      CHECK(none > 0);
      CHECK(some == (found.empty() ? std::ssize(faces) - none : 0));
      must(program.run("which", 1));
      found.push_back({must(program.output("presence", "here")), must(program.output("presence", "beside")),
                       must(program.output("which", "seen")), must(program.output("which", "again"))});
    }
    for (size_t k = 0; k < 4; ++k) CHECK(found[0][k].bytes == found[1][k].bytes);
    CHECK(found[0][0].bytes == found[0][3].bytes);
  }
}
