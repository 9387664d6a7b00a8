// SPDX-License-Identifier: Apache-2.0
// What the tests of compiler/io share: a folder that removes itself, and builders of small files that can be made wrong
// in one place at a time.
#pragma once

#include <cstdint>
#include <initializer_list>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "compiler/io/array/array.h"
#include "compiler/io/mesh/mesh.h"

namespace dr::io::test {

// A fresh folder, removed with everything in it at the end of the scope.
class TemporaryFolder {
 public:
  TemporaryFolder();
  ~TemporaryFolder();
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;

  const std::string& path() const { return path_; }
  std::string operator/(std::string_view name) const { return path_ + "/" + std::string(name); }
  // Writes a file (making folders on the way) and returns its path.
  std::string write(std::string_view name, std::string_view content) const;
  std::vector<std::string> names() const;  // of what is in it, sorted

 private:
  std::string path_;
};

std::string read_text(const std::string& path);

// The mesh of a file, which must be right.
Mesh load(const std::string& path);

// The folder with real test data, when there is one.
std::optional<std::string> data_folder();

// `text` with every `from` replaced.
std::string replaced(std::string text, std::string_view from, std::string_view to);

// Little-endian bytes of numbers.
std::string f32(std::initializer_list<float> values);
std::string u32(std::initializer_list<uint32_t> values);
std::string u16(std::initializer_list<uint16_t> values);

// PNG: a chunk with its checksum, and a whole file around uncompressed rows (each starting with its filter byte).
std::string png_chunk(std::string_view name, std::string_view data);
std::string png_header(uint32_t width, uint32_t height, uint8_t bits, uint8_t colour_type);
std::string png_file(uint32_t width, uint32_t height, uint8_t bits, uint8_t colour_type, std::string_view rows);

// Strands: a TressFX file of version 3 or 4 whose vertices count up in tenths, with texture coordinates of roots in
// version 4; and a .hair file of a strand of three vertices and one of two, with the arrays that the bits of `arrays`
// name.
std::string tfx_file(float version, uint32_t strands, uint32_t vertices);
std::string hair_file(uint32_t arrays);

// 16x8 pixels, the left half about (200, 40, 40), the right half about (20, 60, 220).
std::string jpeg_file();
std::string jpeg_of_half_width();  // 16 x 8: red, and two columns of blue; colours at half the width
std::string jpeg_of_inks();        // 4 x 2 of one red, with Adobe's marker

// 8x2 pixels: a run-length coded row of (1, 0.5, 0.25) and a row that counts red up in sixteenths.
std::string hdr_file();

std::string npy_file(std::string_view descr, std::string_view shape, std::string_view data,
                     std::string_view order = "False");

std::string base64(std::string_view bytes);

// Two triangles, four vertices, uv, in one buffer of kQuadBytes: positions at 0, uv at 48, indices (u16) at 80.
inline constexpr int kQuadBytes = 92;
std::string quad_buffer();
// The JSON around it, with `buffer` as the members of buffers[0] besides its length.
std::string quad_json(std::string_view buffer_members);
std::string quad_gltf();  // the buffer embedded as text
std::string quad_glb();
std::string glb_file(std::string_view json, std::string_view binary);

// A file with one of everything: a skinned, morphed triangle on two joints, a camera, two lamps, two materials, one
// picture of two pixels, and an animation that turns the knee a quarter.
class SceneFile {
 public:
  SceneFile();
  std::string glb() const { return glb_file(json_, buffer_); }
  // With other JSON in one place. Precondition: `from` stands there.
  std::string glb(std::string_view from, std::string_view to) const;

 private:
  int add(std::string_view type, int component, int count, const std::string& bytes);

  std::string buffer_, views_, accessors_, json_;
  int count_ = 0;
};

}  // namespace dr::io::test
