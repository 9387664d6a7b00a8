// SPDX-License-Identifier: Apache-2.0
// Strands of .tfx and .hair files: what is read, and what is refused by the name of its field.

#include <algorithm>

#include "compiler/io/array/array.h"
#include "tests/catch.h"
#include "tests/unit/io/support.h"

namespace dr::io {
namespace {

using namespace test;

Array strands_of(std::string_view name, std::string_view content, const std::string& selector) {
  const TemporaryFolder folder;
  Result<Array> array = load_binding(folder.write(name, content) + selector, 0);
  INFO((array.ok() ? std::string() : array.error()));
  REQUIRE(array.ok());
  return std::move(*array);
}

std::string refusal_of(std::string_view name, std::string_view content, const std::string& selector = ":position") {
  const TemporaryFolder folder;
  const Result<Array> array = load_binding(folder.write(name, content) + selector, 0);
  REQUIRE_FALSE(array.ok());
  return array.error();
}

// An empty text where `error` says what is expected, else the error.
std::string missing(const std::string& error, std::string_view expected) {
  return error.find(expected) == std::string::npos ? error : std::string();
}

// A file with other bytes from a place on.
std::string patched(std::string file, size_t at, const std::string& bytes) {
  return file.replace(at, bytes.size(), bytes);
}

template <class T>
std::vector<T> values(Array array) {
  const auto span = array.as<T>();
  return {span.begin(), span.end()};
}

TEST_CASE("TressFX strands are read", "[io][strands]") {
  for (const float version : {3.0f, 4.0f}) {
    const std::string file = tfx_file(version, 2, 3);
    const Array position = strands_of("a.tfx", file, ":position");
    CHECK(position.components == 3);
    CHECK(position.width == 6);
    const auto p = values<float>(position);
    CHECK(p[3] == 0.3f);
    CHECK(p.back() == 0.1f * 17);
    CHECK(values<int32_t>(strands_of("a.tfx", file, ":segments")) == std::vector<int32_t>{0, 1, 1, 2, 3, 4, 4, 5});
    CHECK(values<int32_t>(strands_of("a.tfx", file, ":strand")) == std::vector<int32_t>{0, 0, 1, 1});
  }
  CHECK(strands_of("a.tfx", tfx_file(4, 2, 3), ":root_uv").width == 2);
}

TEST_CASE("hair strands of unlike lengths are read", "[io][strands]") {
  const std::string file = hair_file(31);
  CHECK(values<int32_t>(strands_of("a.hair", file, ":segments")) == std::vector<int32_t>{0, 1, 1, 2, 3, 4});
  CHECK(values<int32_t>(strands_of("a.hair", file, ":strand")) == std::vector<int32_t>{0, 0, 1});
  CHECK(values<float>(strands_of("a.hair", file, ":opacity")) == std::vector<float>{1, 0.875f, 0.75f, 0.625f, 0.5f});
  CHECK(strands_of("a.hair", file, ":color").components == 3);
}

TEST_CASE("what a header says of all strands stands for each vertex", "[io][strands]") {
  // Without counts each strand has one segment: four vertices.
  const std::string file = patched(hair_file(2), 8, u32({4}));
  CHECK(values<float>(strands_of("a.hair", file, ":width")) == std::vector<float>(4, 0.5f));
  CHECK(values<float>(strands_of("a.hair", file, ":opacity")) == std::vector<float>(4, 0.75f));
  CHECK(values<int32_t>(strands_of("a.hair", file, ":segments")) == std::vector<int32_t>{0, 1, 2, 3});
}

TEST_CASE("malformed strands are refused by the name of the field", "[io][strands][malformed]") {
  const std::string four = tfx_file(4, 2, 3), three = tfx_file(3, 2, 3), hair = hair_file(31);
  CHECK(missing(refusal_of("a.tfx", ""), "'version' takes 4 bytes from byte 0 on, the file has 0") == "");
  CHECK(missing(refusal_of("a.tfx", patched(four, 0, f32({5}))), "'version' is 5, expected 3 or 4") == "");
  CHECK(missing(refusal_of("a.tfx", patched(four, 4, u32({0}))), "'numHairStrands' is 0, expected 1 to") == "");
  CHECK(missing(refusal_of("a.tfx", patched(four, 8, u32({1}))), "'numVerticesPerStrand' is 1, expected 2") == "");
  CHECK(missing(refusal_of("a.tfx", patched(four, 4, u32({1u << 24, 1u << 24}))), "more than 16777216 vertices") == "");
  CHECK(missing(refusal_of("a.tfx", patched(four, 12, u32({4}))), "'offsetVertexPosition' is 4") == "");
  CHECK(missing(refusal_of("a.tfx", patched(four, 12, u32({0xffffffffu}))), "'vertex position' takes 96 bytes") == "");
  CHECK(missing(refusal_of("a.tfx", patched(four, 164, u32({0x7fc00000u}))), "vertex position 0 is not finite") == "");
  CHECK(missing(refusal_of("a.tfx", three.substr(0, 300)), "'vertex position' takes 72 bytes from byte 296") == "");
  CHECK(missing(refusal_of("a.tfx", three, ":root_uv"), "no texture coordinates of roots") == "");
  CHECK(missing(refusal_of("a.tfx", three, ":postion"), "did you mean 'position'?") == "");
  CHECK(missing(refusal_of("a.tfx", three, ""), "say which part of the strands") == "");
  CHECK(missing(refusal_of("a.hair", patched(hair, 0, "HAIX")), "the first four bytes are not 'HAIR'") == "");
  CHECK(missing(refusal_of("a.hair", patched(hair, 12, u32({1}))), "the file has no points") == "");
  CHECK(missing(refusal_of("a.hair", patched(hair, 8, u32({6}))), "the strands have 5 vertices, 'point_count' is 6") ==
        "");
  CHECK(missing(refusal_of("a.hair", patched(hair, 4, u32({1u << 24}))), "'segments' takes") == "");
  CHECK(missing(refusal_of("a.hair", patched(hair, 128, u16({0}))), "strand 0 has no segment") == "");
  CHECK(missing(refusal_of("a.hair", patched(hair, 128, u16({60000}))), "strands 0 to 0 have 60001 vertices") == "");
  CHECK(missing(refusal_of("a.hair", hair.substr(0, 200)), "the file has 200") == "");
}

TEST_CASE("real hair has the counts that its source states", "[io][strands][data]") {
  const auto data = data_folder();
  if (!data) {
    WARN("skipped: there is no data folder, name one in DR_DATA");
    return;
  }
  const Result<Array> mohawk = load_binding(*data + "/hair/Ratboy_mohawk.tfx:segments", 2);
  REQUIRE(mohawk.ok());
  CHECK(mohawk->width == 69068);
  const Result<Array> tail = load_binding(*data + "/hair/ponytail/tail.tfx:position", 3);
  REQUIRE(tail.ok());
  CHECK(tail->width == 474 * 16);
}

// Five vertices, and primitives over them.
std::string line_gltf(const std::string& primitives) {
  return R"({"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
    "nodes": [{"mesh": 0, "translation": [0, 0, 2]}], "meshes": [{"primitives": [)" +
         primitives + R"(]}],
    "buffers": [{"byteLength": 80, "uri": "data:application/octet-stream;base64,)" +
         std::string(
             "AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAQAAAgD8AAAAAAABAQAAAAAAA"
             "AAAAAACAQAAAgD8AAIA/AAABAAEAAgADAAQAAAAAAAAAAAA=") +
         R"("}], "bufferViews": [{"buffer": 0, "byteLength": 60}, {"buffer": 0, "byteOffset": 60, "byteLength": 12}],
    "accessors": [{"bufferView": 0, "componentType": 5126, "count": 5, "type": "VEC3", "min": [0, 0, 0],
                   "max": [4, 1, 1]},
                  {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"}]})";
}

TEST_CASE("lines of glTF files are strands", "[io][strands]") {
  const std::string at = R"("attributes": {"POSITION": 0})";
  const std::string list = line_gltf("{" + at + R"(, "indices": 1, "mode": 1})");
  // Two pairs that meet, and one for itself.
  CHECK(values<int32_t>(strands_of("a.gltf", list, ":lines:segments")) == std::vector<int32_t>{0, 1, 1, 2, 3, 4});
  CHECK(values<int32_t>(strands_of("a.gltf", list, ":lines:strand")) == std::vector<int32_t>{0, 0, 1});
  const auto p = values<float>(strands_of("a.gltf", list, ":lines:position"));
  CHECK(p == std::vector<float>{0, 0, 2, 1, 0, 2, 2, 1, 2, 3, 0, 2, 4, 1, 3});
  const std::string loop = line_gltf("{" + at + R"(, "mode": 2})");
  CHECK(values<int32_t>(strands_of("a.gltf", loop, ":lines:segments")).size() == 10);
  CHECK(values<float>(strands_of("a.gltf", loop, ":lines:position"))[15] == 0);
  const std::string strip = line_gltf("{" + at + R"(, "mode": 3}, {)" + at + R"(, "mode": 4})");
  CHECK(values<int32_t>(strands_of("a.gltf", strip, ":lines:strand")) == std::vector<int32_t>(4, 0));
  CHECK(missing(refusal_of("a.gltf", line_gltf("{" + at + R"(, "mode": 0})"), ":lines:position"), "no lines").empty());
  CHECK(missing(refusal_of("a.gltf", loop, ":lines:color"), "no colours").empty());
  CHECK(missing(refusal_of("a.gltf", loop, ":lines"), "say which part").empty());
}

}  // namespace
}  // namespace dr::io
