// SPDX-License-Identifier: Apache-2.0
// Inputs that are wrong in one place, and the exact words that say so. The folder of the file is left out of messages.

#include <cmath>
#include <filesystem>

#include "compiler/io/mesh/mesh.h"
#include "tests/catch.h"
#include "tests/unit/io/support.h"

namespace dr::io {
namespace {

using namespace test;

struct Case {
  std::string name;  // of the file that is written
  std::string content;
  std::string selector;  // ":position"
  std::string error;     // after "cannot read 'name:selector': "
  int expected_components = 0;
};

void check(const std::vector<Case>& cases) {
  for (const Case& c : cases) {
    const TemporaryFolder folder;
    const Result<Array> result = load_binding(folder.write(c.name, c.content) + c.selector, c.expected_components);
    REQUIRE_FALSE(result.ok());
    CHECK(replaced(result.error(), folder.path() + "/", "") == "cannot read '" + c.name + c.selector + "': " + c.error);
  }
}

TEST_CASE("malformed OBJ files are refused by line", "[io][malformed]") {
  const std::string square = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";
  const auto obj = [&](std::string_view text, std::string_view error, std::string_view selector = ":indices") {
    return Case{"a.obj", std::string(text), std::string(selector), std::string(error)};
  };
  check({
      obj("", "there are no vertices ('v' lines)"),
      obj("# nothing\n", "there are no vertices ('v' lines)"),
      obj(square, "there are no faces ('f' lines)"),
      obj("v 0 0\n", "line 1: 'v' needs 3 numbers (or 4, 6 or 7 with weight and colour), found 2"),
      obj("v 0 0 1 2 3\n", "line 1: 'v' needs 3 numbers (or 4, 6 or 7 with weight and colour), found 5"),
      obj("\nv 0 nan 0\n", "line 2: 'nan' is not a finite number"),
      obj("v 0 0 -inf\n", "line 1: '-inf' is not a finite number"),
      obj("v 0 0 1e39\n", "line 1: '1e39' does not fit a float"),
      obj("v 0 0 1e999\n", "line 1: '1e999' does not fit a float"),
      obj("v 0 0 0x10\n", "line 1: '0x10' is not a number"),
      obj("v 0 0 1,5\n", "line 1: '1,5' is not a number"),
      obj("v 0 0 +-1\n", "line 1: '+-1' is not a number"),
      obj(square + "f 1 2\n", "line 5: a face needs 3 corners, found 2"),
      obj(square + "f 1 2 5\n", "line 5: vertex index 5 is out of range, the file has 4"),
      obj(square + "f 1 2 -5\n", "line 5: vertex index '-5' is out of range, there are 4 so far"),
      obj(square + "f 1 2 0\n", "line 5: vertex index 0 is not allowed, indices start at 1"),
      obj(square + "f 1 2 99999999999999999999\n",
          "line 5: vertex index '99999999999999999999' is out of range, there are 4 so far"),
      obj(square + "f 1 2 x\n", "line 5: 'x' is not a face corner (expected v, v/vt, v//vn or v/vt/vn)"),
      obj(square + "f 1 2 3.5\n", "line 5: '3.5' is not a face corner (expected v, v/vt, v//vn or v/vt/vn)"),
      obj(square + "f 1 2 3/\n", "line 5: '3/' is not a face corner (expected v, v/vt, v//vn or v/vt/vn)"),
      obj(square + "f 1/1 2/1 3/1\n", "line 5: texture coordinate index 1 is out of range, the file has 0"),
      obj(square + "vt 0 0\nf 1/1 2/2 3/1\nf 1 2 3\n",
          "line 6: texture coordinate index 2 is out of range, the file has 1"),
      obj(square + "f 1//1 2//1 3//1\n", "line 5: normal index 1 is out of range, the file has 0"),
      obj(square + "vt 0 0\nf 1/1 2 3/1\n",
          "line 6: corner '2' is written unlike '1/1', all corners of a face have the same parts"),
      obj(square + "vt\n", "line 5: 'vt' needs 1 to 3 numbers, found 0"),
      obj(square + "vn 0 0\n", "line 5: 'vn' needs 3 numbers, found 2"),
      obj(square + "usemt red\n", "line 5: unknown statement 'usemt' (did you mean 'usemtl'?)"),
      obj(square + "curv2 1 2\n", "line 5: 'curv2' belongs to a free-form surface, only polygons are read"),
      obj(std::string("v 0 0 0\nv \0 0 0\n", 16), "line 2: a zero byte: this is not a text file"),
      obj("v 0 0 \\\n\\\nx\n", "line 1: 'x' is not a number"),
      obj("v 0 0 \x1b[31m\n", "line 1: '\\x1b[31m' is not a number"),
      obj(square + "f 1 2 3\n", "there are no texture coordinates ('vt' lines)", ":uv"),
      obj(square + "vt 0 0\nf 1 2 3\n", "line 6: this face has no texture coordinates", ":uv_indices"),
      obj(square + "f 1 2 3\n", "there are no normals ('vn' lines)", ":normal"),
      obj(square + "f 1 2 3\n", "not every vertex has a colour ('v x y z r g b')", ":color"),
  });
}

TEST_CASE("malformed glTF files are refused by path", "[io][malformed]") {
  const auto gltf = [](std::string_view from, std::string_view to, std::string_view error) {
    const std::string good = quad_gltf();
    REQUIRE(good.find(from) != std::string::npos);
    return Case{"a.gltf", replaced(good, from, to), ":position", std::string(error)};
  };
  const std::string kIndices = R"({"bufferView": 2, "componentType": 5123, "count": 6, "type": "SCALAR"})";
  check({
      {"a.gltf", "", ":position", "the file is empty"},
      {"a.gltf", "{\"asset\": ", ":position", "byte 11: not valid JSON"},
      {"a.gltf", "[1e999]", ":position", "not valid JSON: a number does not fit"},
      {"a.gltf", std::string(100, '['), ":position", "JSON is nested deeper than 64"},
      {"a.gltf", "[]", ":position", "the root of the JSON is not an object"},
      {"a.gltf", "{}", ":position", "the file: 'asset' is missing"},
      gltf(R"("2.0")", R"("1.0")", "asset.version: '1.0', only 2.x is read"),
      gltf(R"("scene": 0)", R"("extensionsRequired": ["KHR_draco_mesh_compression"])",
           "it requires the extension 'KHR_draco_mesh_compression', which is not read"),
      gltf(R"("scene": 0)", R"("scene": 1)", "scene: there is no scenes[1], the file has 1"),
      gltf(R"("scene": 0)", R"("scene": -1)", "the file.scene: expected a non-negative integer, found '-1'"),
      gltf(R"("nodes": [0])", R"("nodes": [1])", "scenes[0].nodes: there is no nodes[1], the file has 1"),
      gltf(R"({"mesh": 0})", R"({"mesh": 0, "children": [0]})",
           "nodes[0]: it is reached twice, nodes must form a tree"),
      gltf(R"({"mesh": 0})", R"({"mesh": 0, "matrix": [1]})", "nodes[0].matrix: expected 16 numbers, found 1"),
      gltf(R"({"mesh": 0})", R"({"mesh": 0, "rotation": [0, 0, 0, 0]})", "nodes[0].rotation: not a unit quaternion"),
      gltf(R"({"mesh": 0})", R"({"mesh": 0, "scale": [1e200, 1, 1]})",
           "meshes[0].primitives[0].attributes.POSITION: element 1 leaves the range of a float when placed"),
      gltf(R"("indices": 2)", R"("indices": 9)",
           "meshes[0].primitives[0].indices: there is no accessors[9], the file has 3"),
      gltf(R"("indices": 2)", R"("indices": 2, "mode": 1)",
           "meshes[0].primitives[0].mode: 1 is points or lines, only triangles are read; ':lines' reads lines"),
      gltf(R"("indices": 2)", R"("indices": 0)",
           "meshes[0].primitives[0].indices: expected unsigned scalars, found 3 x component type 5126"),
      gltf(R"("POSITION": 0, )", "", "meshes[0].primitives[0]: there is no POSITION"),
      gltf(R"("POSITION": 0)", R"("POSITION": 1)",
           "meshes[0].primitives[0].attributes.POSITION: 2 components, expected 3"),
      gltf(R"("count": 4, "type": "VEC2")", R"("count": 3, "type": "VEC2")",
           "meshes[0].primitives[0].attributes.TEXCOORD_0: 3 elements, but POSITION has 4"),
      gltf(R"("count": 4, "type": "VEC3")", R"("count": 5, "type": "VEC3")",
           "accessors[0]: 5 elements of 12 bytes, 12 apart from byte 0, do not fit the buffer view of 48"),
      gltf(R"("count": 4, "type": "VEC3")", R"("count": 0, "type": "VEC3")", "accessors[0].count: it is 0"),
      gltf(R"("count": 4, "type": "VEC3")", R"("count": 18446744073709551615, "type": "VEC3")",
           "accessors[0].count: 18446744073709551615 is over the limit of 16777216"),
      gltf(R"("count": 4, "type": "VEC3")", R"("count": 4.5, "type": "VEC3")",
           "accessors[0].count: expected a non-negative integer, found '4.5'"),
      gltf(R"("count": 4, "type": "VEC3")", R"("count": 4, "type": "VEC5")",
           "accessors[0].type: 'VEC5' is not an accessor type"),
      gltf(R"({"bufferView": 0, "componentType": 5126)",
           R"({"bufferView": 0, "byteOffset": 18446744073709551612, "componentType": 5126)",
           "accessors[0]: 4 elements of 12 bytes, 12 apart from byte 18446744073709551612, do not fit the buffer view "
           "of 48"),
      gltf(R"({"bufferView": 0, "componentType": 5126)",
           R"({"bufferView": 0, "byteOffset": "4", "componentType": 5126)",
           "accessors[0].byteOffset: expected a non-negative integer, found '\"4\"'"),
      gltf(R"({"bufferView": 0, "componentType": 5126)", R"({"bufferView": 0, "componentType": 5124)",
           "accessors[0].componentType: 5124 is not one of 5120, 5121, 5122, 5123, 5125, 5126"),
      gltf(R"("byteOffset": 0, "byteLength": 48)", R"("byteOffset": 0, "byteLength": 48, "byteStride": 8)",
           "bufferViews[0].byteStride: 8 is not in 12 to 252"),
      gltf(R"("byteOffset": 48, "byteLength": 32)", R"("byteOffset": 90, "byteLength": 32)",
           "bufferViews[1]: 32 bytes from byte 90 do not fit the buffer of 92"),
      gltf(R"("byteOffset": 48, "byteLength": 32)", R"("byteOffset": 18446744073709551600, "byteLength": 32)",
           "bufferViews[1]: 32 bytes from byte 18446744073709551600 do not fit the buffer of 92"),
      gltf(R"("byteOffset": 80, "byteLength": 12)", R"("byteOffset": 79, "byteLength": 12)",
           "meshes[0].primitives[0].indices: index 1 is 256, the primitive has 4 vertices"),
      gltf(kIndices, R"({"bufferView": 2, "componentType": 5123, "count": 5, "type": "SCALAR"})",
           "meshes[0].primitives[0]: 5 indices are not a multiple of 3"),
      gltf(R"("byteLength": 92)", R"("byteLength": 93)", "buffers[0].byteLength: it says 93 bytes, there are 92"),
      gltf("base64,AAAA", "base64,AA?A", "buffers[0].uri: character 2 of the base64 text is '?'"),
      gltf(";base64", "", "buffers[0].uri: a data URI must be base64, found 'application/octet-stream'"),
  });
}

TEST_CASE("sparse accessors are checked", "[io][malformed]") {
  const auto sparse = [](std::string_view members, std::string_view error) {
    return Case{"a.gltf",
                replaced(quad_gltf(), R"({"bufferView": 0, "componentType": 5126)",
                         R"({"bufferView": 0, "sparse": {)" + std::string(members) + R"(}, "componentType": 5126)"),
                ":position", std::string(error)};
  };
  const std::string values = R"(, "values": {"bufferView": 0})";
  check({
      sparse(R"("count": 1)", "accessors[0].sparse: 'indices' is missing"),
      sparse(R"("count": 5, "indices": {"bufferView": 2, "componentType": 5123})" + values,
             "accessors[0].sparse.count: 5 is not in 1 to the accessor's 4"),
      sparse(R"("count": 4, "indices": {"bufferView": 2, "componentType": 5126})" + values,
             "accessors[0].sparse.indices.componentType: 5126 is not one of 5121, 5123, 5125"),
      // 0, 1, 2, 0: goes back.
      sparse(R"("count": 4, "indices": {"bufferView": 2, "componentType": 5123})" + values,
             "accessors[0].sparse.indices: index 3 is 0 after 2, they must increase"),
      // Read as 32 bits: 0x00010000.
      sparse(R"("count": 1, "indices": {"bufferView": 2, "componentType": 5125})" + values,
             "accessors[0].sparse.indices: index 0 is 65536, the accessor has 4 elements"),
      sparse(R"("count": 1, "indices": {"bufferView": 2, "byteOffset": 11, "componentType": 5123})" + values,
             "accessors[0].sparse.indices: 1 element of 2 bytes, 2 apart from byte 11, do not fit the buffer view of "
             "12"),
      sparse(R"("count": 2, "indices": {"bufferView": 2, "componentType": 5123},
                "values": {"bufferView": 0, "byteOffset": 36})",
             "accessors[0].sparse.values: 2 elements of 12 bytes, 12 apart from byte 36, do not fit the buffer view of "
             "48"),
      sparse(R"("count": 1, "indices": {"bufferView": 7, "componentType": 5123})" + values,
             "accessors[0].sparse.indices.bufferView: there is no bufferViews[7], the file has 3"),
  });
}

TEST_CASE("buffers outside of the folder are refused", "[io][malformed]") {
  const auto uri = [](std::string_view text, std::string_view error) {
    return Case{"sub/a.gltf", quad_json(", \"uri\": \"" + std::string(text) + "\""), ":position",
                "buffers[0].uri: " + std::string(error)};
  };
  const std::string_view out = "leads out of the folder of the glTF file";
  const std::string_view scheme = "has a scheme, only 'data:' and files in the folder of the glTF file are read";
  check({
      uri("../a.bin", "'../a.bin' " + std::string(out)),
      uri("x/../../a.bin", "'x/../../a.bin' " + std::string(out)),
      uri("%2e%2E/a.bin", "'%2e%2E/a.bin' " + std::string(out)),
      uri("/etc/passwd", "'/etc/passwd' " + std::string(out)),
      uri("file:///etc/passwd", "'file:///etc/passwd' " + std::string(scheme)),
      uri("http://example.org/a.bin", "'http://example.org/a.bin' " + std::string(scheme)),
      uri("C:/a.bin", "'C:/a.bin' " + std::string(scheme)),
      uri("..\\\\a.bin", "'..\\a.bin' holds a backslash"),
      uri("a%00.bin", "'a%00.bin' holds a zero byte"),
      uri("a%0.bin", "'a%0.bin' has a bad % escape"),
      uri("", "'' names no file"),
      uri("none.bin", "cannot read 'none.bin': no such file"),
  });

  // A link that leads out is not followed either; one that stays is.
  const TemporaryFolder folder;
  folder.write("secret.bin", quad_buffer());
  const std::string path = folder.write("sub/a.gltf", quad_json(R"(, "uri": "link.bin")"));
  std::filesystem::create_symlink("../secret.bin", folder / "sub/link.bin");
  CHECK(load_mesh(path).error() == "cannot read '" + path + "': buffers[0].uri: 'link.bin' " + std::string(out));
  std::filesystem::remove(folder / "sub/link.bin");
  folder.write("sub/own.bin", quad_buffer());
  std::filesystem::create_symlink("own.bin", folder / "sub/link.bin");
  CHECK(load_mesh(path).ok());
}

TEST_CASE("malformed GLB containers are refused by byte", "[io][malformed]") {
  const std::string good = quad_glb();
  const std::string json = quad_json("");
  const auto glb = [](std::string content, std::string_view error) {
    return Case{"a.glb", std::move(content), ":position", std::string(error)};
  };
  const auto changed = [&](size_t at, std::string_view bytes) {
    std::string copy = good;
    return copy.replace(at, bytes.size(), bytes);
  };
  const size_t binary = 20 + (json.size() + 3) / 4 * 4;
  check({
      glb("glTF", "a GLB header has 12 bytes, the file has 4"),
      glb(changed(4, u32({1})), "byte 4: GLB version 1, only 2 is read"),
      glb(changed(8, u32({9999})), "byte 8: the header says 9999 bytes, the file has " + std::to_string(good.size())),
      glb(good + "x", "byte 8: the header says " + std::to_string(good.size()) + " bytes, the file has " +
                          std::to_string(good.size() + 1)),
      glb(changed(12, u32({0xfffffffc})),
          "byte 12: chunk 0 has 4294967292 bytes, only " + std::to_string(good.size() - 20) + " are left"),
      glb(changed(16, "BIN"), "byte 16: the first chunk is not JSON"),
      // A claim of 4 bytes more than the file holds, header of the chunk included.
      glb(changed(binary, u32({96})), "byte " + std::to_string(binary) + ": chunk 1 has 96 bytes, only 92 are left"),
      glb(glb_file(json, ""), "buffers[0]: 'uri' is missing"),
      glb(glb_file(json, quad_buffer().substr(4)), "buffers[0].byteLength: it says 92 bytes, there are 88"),
      glb(glb_file(json, f32({0, NAN}) + quad_buffer().substr(8)),
          "meshes[0].primitives[0].attributes.POSITION: element 0 holds NaN"),
      glb(glb_file(json, quad_buffer().substr(0, 76) + f32({-INFINITY}) + quad_buffer().substr(80)),
          "meshes[0].primitives[0].attributes.TEXCOORD_0: element 3 holds an infinite value"),
      glb(glb_file(json, quad_buffer().substr(0, 90) + u16({4})),
          "meshes[0].primitives[0].indices: index 5 is 4, the primitive has 4 vertices"),
  });
}

TEST_CASE("malformed pictures are refused by byte", "[io][malformed]") {
  const std::string png = png_file(2, 1, 8, 0, std::string(3, '\0'));
  const std::string jpeg = jpeg_file();
  const std::string hdr = hdr_file();
  std::string flipped = png;
  flipped[45] = static_cast<char>(flipped[45] ^ 1);
  const auto picture = [](std::string_view name, std::string content, std::string_view error) {
    return Case{std::string(name), std::move(content), "", std::string(error)};
  };
  std::string large_jpeg = jpeg;
  const size_t frame = jpeg.find("\xff\xc0");
  large_jpeg.replace(frame + 5, 2, "\x60\x60");
  // What a careless decoder would write past its tables, or read from tables that it never filled.
  const size_t table = jpeg.find("\xff\xc4");
  std::string counts(16, '\0');
  counts[7] = '\xff';
  counts[15] = 2;
  const std::string many_symbols = jpeg.substr(0, table) + std::string("\xff\xc4\x01\x14\0", 5) + counts +
                                   std::string(257, 'x') + jpeg.substr(table);
  std::string many_codes = jpeg;
  many_codes.replace(table + 5, 1, "\x03");
  std::string twelve_bits = jpeg;
  twelve_bits.replace(frame + 4, 1, "\x0c");
  // The last third of the coded data is missing, and the file ends as it should.
  const std::string cut_jpeg = jpeg.substr(0, 612) + "\xff\xd9";
  // One component again and again: two blocks of nothing.
  std::string many_scans = jpeg.substr(0, jpeg.find("\xff\xda"));
  for (int i = 0; i < 600; ++i) many_scans += std::string("\xff\xda\0\x08\x01\x01\0\0\x3f\0\x28\xaf", 12);
  many_scans += "\xff\xd9";
  const std::string no_quantization = jpeg.substr(0, 20) + jpeg.substr(frame);
  check({
      picture("a.png", "", "the file is empty"),
      picture("a.png", "GIF89a", "byte 0: this is a GIF file"),
      picture("a.png", "hello", "byte 0: neither a PNG nor a JPEG file"),
      picture("a.png", png_file(0, 1, 8, 0, "x"), "byte 16: a picture of 0x1, sides must be in 1 to 16384"),
      picture("a.png", png_file(16385, 1, 8, 0, "x"), "byte 16: a picture of 16385x1, sides must be in 1 to 16384"),
      picture("a.png", png_file(1, 0xffffffff, 8, 0, "x"),
              "byte 16: a picture of 1x4294967295, sides must be in 1 to 16384"),
      // Both sides are allowed, all of it is not: the decoder counts in 32 bits.
      picture("a.png", png_file(16384, 16384, 16, 6, "x"),
              "byte 16: a picture of 16384x16384 with 4 x 16 bits takes 2147483648 bytes, the limit is 2147483647"),
      picture("a.png", flipped, "byte 33: chunk 'IDAT' is damaged, its checksum differs"),
      picture("a.png", png.substr(0, 40), "byte 33: the file is cut short, a chunk was expected"),
      picture("a.png", png.substr(0, 50), "byte 33: the file is cut short, chunk 'IDAT' has 14 bytes, 5 are left"),
      picture("a.png", png_header(2, 1, 8, 0) + png_chunk("IEND", ""), "byte 33: there is no picture data"),
      picture("a.png", png_file(2, 2, 8, 0, std::string(3, '\0')), "the picture data is damaged (not enough pixels)"),
      picture("a.png", png_file(2, 1, 9, 0, std::string(3, '\0')), "the picture data is damaged (1/2/4/8/16-bit only)"),
      picture("a.png", png.substr(0, 8) + png_chunk("IDAT", "x"),
              "byte 8: the first chunk is not a header of 13 bytes"),
      picture("a.jpg", jpeg.substr(0, jpeg.size() - 2), "byte 621: the file is cut short"),
      picture("a.jpg", jpeg.substr(0, 100), "byte 100: the file is cut short"),
      picture("a.jpg", cut_jpeg, "byte 607: Corrupt JPEG data: premature end of data segment"),
      picture("a.jpg", large_jpeg, "byte 607: a picture of 16x24672, sides must be in 1 to 16384"),
      picture("a.jpg", many_symbols, "byte 175: Bogus Huffman table definition"),
      picture("a.jpg", many_codes, "byte 175: Bogus Huffman table definition"),
      picture("a.jpg", no_quantization, "byte 473: Quantization table 0x00 was not defined"),
      picture("a.jpg", twelve_bits, "byte 607: Unsupported JPEG data precision 12"),
      picture("a.jpg", many_scans, "byte 6603: it has too many scans"),
      picture("a.jpg", "\xff\xd8\xff\xd9", "byte 4: JPEG datastream contains no image"),
      picture("a.hdr", "P6 1 1", "byte 0: not a Radiance HDR file"),
      picture("a.hdr", "#?RADIANCE\n", "byte 11: the header is cut short"),
      picture("a.hdr", "#?RADIANCE\n\n-Y 1 +X 1\n", "byte 12: the header has no FORMAT"),
      picture("a.hdr", replaced(hdr, "rgbe", "xyze"),
              "byte 11: 'FORMAT=32-bit_rle_xyze', only 32-bit_rle_rgbe is read"),
      picture("a.hdr", replaced(hdr, "-Y 2 +X 8", "+Y 2 +X 8"), "byte 35: '+Y 2 +X 8', expected '-Y height +X width'"),
      picture("a.hdr", replaced(hdr, "-Y 2", "-Y 0"), "byte 35: a picture of 8x0, sides must be in 1 to 16384"),
      picture("a.hdr", replaced(hdr, "-Y 2", "-Y 9999"),
              "byte 48: the file is cut short, 31 bytes cannot hold 9999 rows"),
      picture("a.hdr", replaced(hdr, "-Y 2 +X 8", "-Y 16384 +X 16384"),
              "byte 35: a picture of 16384x16384 with 3 x 32 bits takes 3221225472 bytes, the limit is 2147483647"),
      picture("a.hdr", replaced(hdr, "+X 8", "+X 9"), "byte 45: row 0 says it has 8 pixels, the picture has 9"),
      picture("a.hdr", hdr.substr(0, hdr.size() - 1), "byte 75: the file is cut short in row 1"),
  });
}

TEST_CASE("pictures that do not fit what is asked for are refused", "[io][malformed]") {
  const std::string grey = png_file(1, 1, 8, 0, std::string(2, '\0'));
  const std::string rgb = png_file(1, 1, 8, 2, std::string(4, '\0'));
  check({
      {"a.png", grey, ":a", "it has no alpha, it stores grey"},
      {"a.png", grey, "", "it gives 1 component (it stores grey), expected 3; ':rgb' gives the colour", 3},
      {"a.png", rgb, "", "it gives 3 components (it stores rgb), expected 4; ':rgba' gives the colour and alpha", 4},
      {"a.png", rgb, "", "it gives 3 components (it stores rgb), expected 1; ':r' picks one", 1},
      {"a.png", rgb, ":rbg",
       "unknown selector 'rbg' (did you mean 'rgb'?), a picture takes ':raw', ':r', ':rgb', "
       "':rgba' or ':a'"},
      {"a.png", rgb, ":r:a", "one of ':r', ':rgb', ':rgba' and ':a' is enough"},
      {"a.png", rgb, ":", "unknown selector '', a picture takes ':raw', ':r', ':rgb', ':rgba' or ':a'"},
  });

  const TemporaryFolder folder;
  folder.write("a.png", grey);
  folder.write("b.png", png_file(2, 1, 8, 0, std::string(3, '\0')));
  folder.write("c.png", rgb);
  const auto error = [&](std::string_view pattern) {
    return replaced(load_binding(folder / pattern).error(), folder.path() + "/", "");
  };
  CHECK(error("[ab]*.png") == "cannot read '[ab]*.png': no file matches");
  CHECK(error("?.png") ==
        "cannot read '?.png': 'b.png': it has 2x1 pixels, 'a.png' has 1x1; the pictures of a stack have one size");
  CHECK(error("no/*.png") == "cannot read 'no/*.png': there is no folder 'no/'");
  CHECK(error("*/a.png") == "cannot read '*/a.png': only the file name may hold '*' or '?'");
  CHECK(error("*.npy") == "cannot read '*.npy': only pictures are stacked by a pattern, found the extension '.npy'");
  std::filesystem::remove(folder / "b.png");
  CHECK(error("*.png") ==
        "cannot read '*.png': 'c.png': it stores rgb, 'a.png' stores grey; ':r', ':rgb' or ':rgba' "
        "make them alike");
}

TEST_CASE("malformed .npy files are refused", "[io][malformed]") {
  const auto npy = [](std::string content, std::string_view error, int expected_components = 0) {
    return Case{"a.npy", std::move(content), "", std::string(error), expected_components};
  };
  const std::string six = f32({1, 2, 3, 4, 5, 6});
  const std::string good = npy_file("<f4", "(2, 3)", six);
  std::string version = good;
  version[6] = 4;
  check({
      npy("", "byte 0: not a .npy file"),
      npy("\x93NUMPY", "byte 6: the header is cut short"),
      npy(version, "byte 6: version 4, only 1 to 3 are read"),
      npy(good.substr(0, 60), "byte 60: the header is cut short"),
      npy(good.substr(0, good.size() - 1), "shape (2, 3) of '<f4' takes 24 bytes, the file has 23"),
      npy(good + "x", "shape (2, 3) of '<f4' takes 24 bytes, the file has 25"),
      npy(npy_file("<f4", "(2, 3)", six, "True"),
          "it is stored in Fortran order, save it through numpy.ascontiguousarray"),
      npy(npy_file("<c8", "(3,)", six),
          "the scalar type '<c8' is not read, expected floats (f2, f4, f8), integers or bools"),
      npy(npy_file("|O", "(3,)", six),
          "the scalar type '|O' is not read, expected floats (f2, f4, f8), integers or bools"),
      npy(npy_file("<f4", "(0, 3)", ""), "shape (0, 3) has no elements"),
      npy(npy_file("<f4", "(-2, 3)", six), "byte 61: expected a dimension"),
      npy(npy_file("<f4", "(4294967296, 4294967296, 1)", ""),
          "an array of 1x4294967296x4294967296 elements with 1 x float64 is larger than 17179869184 bytes"),
      npy(npy_file("<f4", "(1, 1, 1, 2, 3)", six),
          "shape (1, 1, 1, 2, 3) has too many dimensions, expected layers, height, width"),
      npy(npy_file("<f4", "(2, 3)", six), "shape (2, 3) does not end in the 4 components of an element", 4),
      npy(npy_file("<f4", "(1, 4, 4)", std::string(64, '\0')),
          "shape (1, 4, 4) does not end in the 16 components of an element; a matrix is 16 numbers, column after "
          "column",
          16),
      npy(npy_file("<i8", "(1,)", u32({0, 1})), "scalar 0 is 4294967296, which does not fit an int32"),
      npy(npy_file("<i8", "(2,)", u32({0xffffffff, 0, 0xffffffff, 0xffffffff})),
          "scalar 0 is 4294967295, which does not fit an int32"),
      npy(npy_file("|b1", "(1,)", "\x02"), "scalar 0 of a bool array is 2"),
      npy(npy_file("<f4", "(2, 3) 'x': 1", six), "byte 67: expected '}' in the header"),
      npy(replaced(good, "'fortran_order': False, ", std::string(24, ' ')),
          "byte 128: the header lacks 'descr', 'fortran_order' or 'shape'"),
  });
}

TEST_CASE("malformed literals are refused", "[io][malformed]") {
  const auto error = [](std::string_view text, int expected_components = 0) {
    const Result<Array> result = load_binding(text, expected_components);
    REQUIRE_FALSE(result.ok());
    return result.error();
  };
  CHECK(error("=") == "cannot read the value '': character 1: not valid JSON");
  CHECK(error("=[1, 2") == "cannot read the value '[1, 2': character 6: not valid JSON");
  CHECK(error("=[1, x]") == "cannot read the value '[1, x]': character 5: not valid JSON");
  CHECK(error("=1e999") == "cannot read the value '1e999': a number does not fit a double");
  CHECK(error("=[]") == "cannot read the value '[]': shape (0,) has no elements");
  CHECK(error("=[1, [2]]") == "cannot read the value '[1, [2]]': item 1 is a list, expected a number as before it");
  CHECK(error("=[[1], 2]") == "cannot read the value '[[1], 2]': item 1 is not a list, expected one as before it");
  CHECK(error("=[[1, 2], [3]]") ==
        "cannot read the value '[[1, 2], [3]]': item 1 has 1 items, expected 2 as in the list before it");
  CHECK(error("=[[], 2]") == "cannot read the value '[[], 2]': item 1 is not a list, expected one as before it");
  CHECK(error("=[1, null]") == "cannot read the value '[1, null]': item 1 is null, expected a number, true or false");
  CHECK(error("=\"a\"") == "cannot read the value '\"a\"': the literal is a string, expected a number, true or false");
  CHECK(error("={}") == "cannot read the value '{}': the literal is an object, expected a number, true or false");
  CHECK(error("=[1, true]") == "cannot read the value '[1, true]': true and false do not mix with numbers");
  CHECK(error("=[[[[[1]]]]]") == "cannot read the value '[[[[[1]]]]]': lists are nested deeper than 4");
  CHECK(error("=[1, 2, 3, 4]", 3) ==
        "cannot read the value '[1, 2, 3, 4]': shape (4,) does not end in the 3 components of an element");
  CHECK(error("=2", 3) ==
        "cannot read the value '2': shape () does not end in the 3 components of an element; such as "
        "=[0, 0, 0]");
  CHECK(error("=[[[[1, 2]]]]", 1) ==
        "cannot read the value '[[[[1, 2]]]]': shape (1, 1, 1, 2) has too many dimensions, expected layers, height, "
        "width");
}

TEST_CASE("tables that are none are refused with their line", "[io][malformed]") {
  const TemporaryFolder folder;
  const auto error = [&](const char* text, int expected_components = 0) {
    folder.write("t.csv", text);
    return replaced(load_binding(folder / "t.csv", expected_components).error(), folder.path() + "/", "");
  };
  CHECK(error("") == "cannot read 't.csv': there are no numbers in it");
  CHECK(error("x,y\n1,2\n3\n") == "cannot read 't.csv': line 3: expected 2 numbers as in the line before it, found 1");
  CHECK(error("1,2\n3,four\n") == "cannot read 't.csv': line 2: expected a number, found 'four'");
  CHECK(error("1,2\n3,\n") == "cannot read 't.csv': line 2: expected a number, found ''");
  CHECK(error("\"1\",\"2\"\n3,\"four\"\n") == "cannot read 't.csv': line 2: expected a number, found 'four'");
  // What is mistyped or missing is no heading.
  for (const std::string number : {"1.O", "1e5x", "-", "1.0.0", "+x", ".x", "N/A", "null", "\u22121"}) {
    const std::string expected = "cannot read 't.csv': line 1: expected a number, found '" + number + "'";
    CHECK(error((number + "\n2\n3\n").c_str()) == expected);
    CHECK(error(("\"" + number + "\",x\n2,3\n").c_str()) == expected);
  }
  CHECK(error("x,1.O\n2,3\n") == "cannot read 't.csv': line 1: expected a number, found '1.O'");
  CHECK(error(",\n2,3\n") == "cannot read 't.csv': line 1: expected a number, found ''");
  CHECK(error("x,3\n2,3\n") == "cannot read 't.csv': line 1: expected a number, found 'x'");
  folder.write("t.csv", ",Na,x-1,N/A rate\n1,2,3,4\n");
  CHECK(load_binding(folder / "t.csv").value().to_doubles() == std::vector<double>{1, 2, 3, 4});
  folder.write("t.csv", "\"left, right\",\"up\"\n\"1\", 2\n");
  CHECK(load_binding(folder / "t.csv").value().to_doubles() == std::vector<double>{1, 2});
  folder.write("t.csv", "\"1\",\"2\"\n3,4\n");
  CHECK(load_binding(folder / "t.csv").value().to_doubles() == std::vector<double>{1, 2, 3, 4});
  CHECK(error("1,2\n3,4\n", 3) == "cannot read 't.csv': shape (2, 2) does not end in the 3 components of an element");
}

TEST_CASE("sources that name nothing are refused with what to do", "[io][malformed]") {
  const TemporaryFolder folder;
  const std::string mesh = folder.write("m.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
  folder.write("data.csv", "1,2");
  folder.write("x.npy", "");
  std::filesystem::create_directory(folder / "dir.png");
  const auto error = [&](std::string_view source, int expected_components = 0) {
    return replaced(load_binding(folder / source, expected_components).error(), folder.path() + "/", "");
  };
  CHECK(error("none.obj:position") == "cannot read 'none.obj:position': no such file");
  CHECK(error("dir.png") == "cannot read 'dir.png': it is a folder");
  CHECK(error("m.obj") ==
        "cannot read 'm.obj': say which part of the mesh: add ':position', ':indices', ':uv', "
        "':uv_indices', ':normal' or ':color'");
  CHECK(error("m.obj:positon") == "cannot read 'm.obj:positon': unknown selector 'positon' (did you mean 'position'?)");
  CHECK(error("m.obj:positions") ==
        "cannot read 'm.obj:positions': unknown selector 'positions' (did you mean 'position'?)");
  CHECK(error("m.obj:uv_index") ==
        "cannot read 'm.obj:uv_index': unknown selector 'uv_index' (did you mean 'uv_indices'?)");
  CHECK(error("m.obj:weights") ==
        "cannot read 'm.obj:weights': unknown selector 'weights', expected ':position', "
        "':indices', ':uv', ':uv_indices', ':normal' or ':color'");
  CHECK(error("m.obj:uv:position") == "cannot read 'm.obj:uv:position': one selector is enough for a mesh, found 2");
  CHECK(error("m.obj:position", 4) == "cannot read 'm.obj:position': it has 3 components an element, expected 4");
  CHECK(error("x.npy:raw") == "cannot read 'x.npy:raw': a .npy file has no selectors, found 'raw'");
  CHECK(error("data.table") ==
        "cannot read 'data.table': unknown extension '.table', expected a .obj, .gltf, .glb, .tfx, .hair, .png, "
        ".jpg, .hdr, .npy, .csv or .json file or a number or list after '='");
  CHECK(error("data.pngg") ==
        "cannot read 'data.pngg': unknown extension '.pngg' (did you mean '.png'?), expected a .obj, .gltf, .glb, "
        ".tfx, .hair, "
        ".png, .jpg, .hdr, .npy, .csv or .json file or a number or list after '='");
  CHECK(load_binding("").error() == "expected a file, or a number or list, after '='");
  CHECK(load_mesh(folder / "x.npy").error() ==
        "cannot read '" + (folder / "x.npy") + "': unknown extension '.npy', a mesh is .obj, .gltf or .glb");
  CHECK(load_binding(std::string("a\0.npy", 6)).error() == "cannot read 'a\\x00.npy': the name holds a zero byte");
}

}  // namespace
}  // namespace dr::io
