// SPDX-License-Identifier: Apache-2.0
// Files cut short at every length, and files with random bytes changed: whatever happens, it is a Result. Run under the
// sanitizers, this is also the test of every bound.

#include <cmath>
#include <filesystem>
#include <random>

#include "compiler/io/mesh/mesh.h"
#include "tests/catch.h"
#include "tests/unit/io/support.h"

namespace dr::io {
namespace {

using namespace test;

struct Sample {
  std::string_view name;
  std::string_view selector;
  std::string content;
  bool every_prefix_fails;  // text formats may end early and still be whole
};

std::vector<Sample> samples() {
  return {
      {"a.png", "", png_file(4, 2, 8, 2, std::string(26, '\0')), true},
      {"a.jpg", "", jpeg_file(), true},
      {"a.hdr", "", hdr_file(), true},
      {"a.npy", "", npy_file("<f4", "(2, 3)", f32({1, 2, 3, 4, 5, 6})), true},
      {"a.glb", ":position", quad_glb(), true},
      {"a.gltf", ":position", quad_gltf(), true},
      {"a.obj", ":position",
       "v 0 0 0\nv 1 0 0 # c\nv 0 1 \\\n 0\nvt 0 0.5\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1\nf -1/-1/-1 -2/1/1 -3/1/1\n",
       false},
  };
}

// Every array and mesh that comes back must be sound.
void check_sound(const Result<Array>& result) {
  if (!result.ok()) {
    CHECK(result.error().starts_with("cannot read "));
    return;
  }
  CHECK(result->consistent());
}

TEST_CASE("a file cut short is an error at every length", "[io][damage]") {
  const TemporaryFolder folder;
  for (const Sample& sample : samples()) {
    INFO(sample.name);
    const std::string path = folder.write(sample.name, sample.content);
    REQUIRE(load_binding(path + std::string(sample.selector)).ok());
    for (size_t length = sample.content.size(); length-- > 0;) {
      std::filesystem::resize_file(path, length);
      const Result<Array> result = load_binding(path + std::string(sample.selector));
      check_sound(result);
      if (sample.every_prefix_fails) {
        INFO("length " << length);
        CHECK_FALSE(result.ok());
      }
    }
  }
}

TEST_CASE("a buffer file cut short is an error", "[io][damage]") {
  const TemporaryFolder folder;
  const std::string path = folder.write("a.gltf", quad_json(R"(, "uri": "a.bin")"));
  const std::string buffer = folder.write("a.bin", quad_buffer());
  CHECK(load_mesh(path).ok());
  for (size_t length = static_cast<size_t>(kQuadBytes); length-- > 0;) {
    std::filesystem::resize_file(buffer, length);
    CHECK_FALSE(load_mesh(path).ok());
  }
}

TEST_CASE("random damage never does more than fail", "[io][damage]") {
  const TemporaryFolder folder;
  std::mt19937 random(20240229);  // fixed: a failure repeats
  const auto below = [&](size_t limit) { return static_cast<size_t>(random()) % limit; };
  // What breaks parsers: signs, extremes, structure.
  const std::string_view spices[] = {
      "-1", "4294967295", "18446744073709551615", "1e999", "null", "[", "{", "\"", "nan", "0", "../", "//",
      "/",  "\\\n"};
  for (const Sample& sample : samples()) {
    INFO(sample.name);
    for (int round = 0; round < 200; ++round) {
      std::string content = sample.content;
      const size_t changes = 1 + below(4);
      for (size_t i = 0; i < changes; ++i) {
        const size_t at = below(content.size());
        switch (below(5)) {
          case 0: content[at] = static_cast<char>(below(256)); break;
          case 1: content[at] = static_cast<char>(content[at] ^ (1 << below(8))); break;
          case 2: content.erase(at, 1 + below(8)); break;
          case 3: content.insert(at, content.substr(below(content.size()), 1 + below(16))); break;
          case 4: content.replace(at, 1, spices[below(std::size(spices))]); break;
        }
        if (content.empty()) content.push_back('x');
      }
      const std::string path = folder.write(sample.name, content);
      check_sound(load_binding(path + std::string(sample.selector)));
      if (sample.selector.empty()) continue;
      const Result<Mesh> mesh = load_mesh(path);
      if (!mesh.ok()) continue;
      bool sound = mesh->positions.size() % 3 == 0 && mesh->indices.size() % 3 == 0;
      for (const float value : mesh->positions) sound = sound && std::isfinite(value);
      for (const float value : mesh->uv) sound = sound && std::isfinite(value);
      for (const int32_t index : mesh->indices) sound = sound && index >= 0 && index < mesh->vertex_count();
      for (const int32_t index : mesh->uv_indices) {
        sound = sound && index >= 0 && static_cast<size_t>(index) < mesh->uv.size() / 2;
      }
      CHECK(sound);
    }
  }
}

}  // namespace
}  // namespace dr::io
