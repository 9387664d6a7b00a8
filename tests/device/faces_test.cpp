// SPDX-License-Identifier: Apache-2.0
// Faces that read the leaf behind a transform (compiler/backend/pack/transform_at_faces.h) show what they show where
// vertices are transformed first, faces of vertices that are not there among them.
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
