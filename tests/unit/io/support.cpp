// SPDX-License-Identifier: Apache-2.0
// Builders of small files for the tests of compiler/io.

#include "tests/unit/io/support.h"

#include <algorithm>
#include <bit>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>
#include <stdexcept>

namespace dr::io::test {
namespace fs = std::filesystem;

namespace {

std::string big_u32(uint32_t value) {
  std::string out;
  for (int shift = 24; shift >= 0; shift -= 8) out += static_cast<char>(value >> shift & 255);
  return out;
}

uint32_t crc32(std::string_view bytes) {
  uint32_t crc = 0xffffffffu;
  for (const char c : bytes) {
    crc ^= static_cast<uint8_t>(c);
    for (int bit = 0; bit < 8; ++bit) crc = (crc & 1) != 0 ? 0xedb88320u ^ (crc >> 1) : crc >> 1;
  }
  return ~crc;
}

constexpr std::string_view kAlphabet = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

std::string decode_base64(std::string_view text) {
  std::string out;
  uint32_t bits = 0;
  int count = 0;
  for (const char c : text) {
    const size_t digit = kAlphabet.find(c);
    if (digit == std::string_view::npos) continue;
    bits = bits << 6 | static_cast<uint32_t>(digit);
    count += 6;
    if (count >= 8) {
      count -= 8;
      out += static_cast<char>(bits >> count & 255);
    }
  }
  return out;
}

}  // namespace

TemporaryFolder::TemporaryFolder() {
  std::random_device random;
  do {
    path_ = (fs::temp_directory_path() / ("dr_io_test_" + std::to_string(random()))).string();
  } while (!fs::create_directory(path_));
}

TemporaryFolder::~TemporaryFolder() {
  std::error_code ignored;
  fs::remove_all(path_, ignored);
}

std::string TemporaryFolder::write(std::string_view name, std::string_view content) const {
  std::string path = *this / name;
  fs::create_directories(fs::path(path).parent_path());
  std::ofstream(path, std::ios::binary).write(content.data(), static_cast<std::streamsize>(content.size()));
  return path;
}

std::vector<std::string> TemporaryFolder::names() const {
  std::vector<std::string> names;
  for (const fs::directory_entry& entry : fs::directory_iterator(path_)) names.push_back(entry.path().filename());
  std::sort(names.begin(), names.end());
  return names;
}

std::string read_text(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

Mesh load(const std::string& path) {
  Result<Mesh> mesh = load_mesh(path);
  if (!mesh.ok()) throw std::runtime_error(mesh.error());
  return std::move(*mesh);
}

std::optional<std::string> data_folder() {
  const char* chosen = std::getenv("DR_DATA");
  std::string folder = chosen ? chosen : DR_SOURCE_DIR "/../shared/data";
  if (!fs::is_directory(folder)) return std::nullopt;
  return folder;
}

std::string replaced(std::string text, std::string_view from, std::string_view to) {
  for (size_t at = text.find(from); at != std::string::npos; at = text.find(from, at + to.size())) {
    text.replace(at, from.size(), to);
  }
  return text;
}

std::string f32(std::initializer_list<float> values) {
  std::string out;
  for (const float value : values) out += u32({std::bit_cast<uint32_t>(value)});
  return out;
}

std::string u32(std::initializer_list<uint32_t> values) {
  std::string out;
  for (const uint32_t value : values) {
    for (int shift = 0; shift < 32; shift += 8) out += static_cast<char>(value >> shift & 255);
  }
  return out;
}

std::string u16(std::initializer_list<uint16_t> values) {
  std::string out;
  for (const uint16_t value : values) {
    out += static_cast<char>(value & 255);
    out += static_cast<char>(value >> 8);
  }
  return out;
}

std::string png_chunk(std::string_view name, std::string_view data) {
  const std::string body = std::string(name) + std::string(data);
  return big_u32(static_cast<uint32_t>(data.size())) + body + big_u32(crc32(body));
}

std::string png_header(uint32_t width, uint32_t height, uint8_t bits, uint8_t colour_type) {
  std::string data = big_u32(width) + big_u32(height);
  data += static_cast<char>(bits);
  data += static_cast<char>(colour_type);
  data += std::string(3, '\0');
  return "\x89PNG\r\n\x1a\n" + png_chunk("IHDR", data);
}

std::string png_file(uint32_t width, uint32_t height, uint8_t bits, uint8_t colour_type, std::string_view rows) {
  uint32_t a = 1;
  uint32_t b = 0;
  for (const char c : rows) {
    a = (a + static_cast<uint8_t>(c)) % 65521;
    b = (b + a) % 65521;
  }
  const auto length = static_cast<uint16_t>(rows.size());
  const std::string stored = std::string("\x78\x01\x01", 3) + u16({length, static_cast<uint16_t>(~length)}) +
                             std::string(rows) + big_u32(b << 16 | a);
  return png_header(width, height, bits, colour_type) + png_chunk("IDAT", stored) + png_chunk("IEND", "");
}

std::string tfx_file(float version, uint32_t strands, uint32_t vertices) {
  const bool old = version == 3;
  const uint32_t start = old ? 296 : 160, count = strands * vertices;
  std::string header = f32({version}) + u32({strands, vertices});
  if (!old) header += u32({start, start + count * 16});
  header.resize(old ? 144 : start);
  if (old) header += u32({start});
  header.resize(start);
  for (uint32_t i = 0; i < count * 3; ++i) {
    header += f32({0.1f * static_cast<float>(i)});
    if (!old && i % 3 == 2) header += f32({1});
  }
  for (uint32_t i = 0; !old && i < strands * 2; ++i) header += f32({0.25f});
  return header;
}

std::string hair_file(uint32_t arrays) {
  std::string out = "HAIR" + u32({2, 5, arrays, 1}) + f32({0.5f, 0.25f, 0.1f, 0.2f, 0.3f});
  out.resize(128);
  if ((arrays & 1) != 0) out += u16({2, 1});
  const auto numbers = [&](int count) {
    for (int i = 0; i < count; ++i) out += f32({0.125f * static_cast<float>(i % 8)});
  };
  if ((arrays & 2) != 0) numbers(15);
  if ((arrays & 4) != 0) numbers(5);
  if ((arrays & 8) != 0) numbers(5);
  if ((arrays & 16) != 0) numbers(15);
  return out;
}

std::string jpeg_file() {
  return decode_base64(
      "/9j/4AAQSkZJRgABAQAAAQABAAD/2wCEAAIBAQEBAQIBAQECAgICAgQDAgICAgUEBAMEBgUGBgYFBgYGBwkIBgcJBwYGCAsICQoKCgoKBggLDA"
      "sKDAkKCgoBAgICAgICBQMDBQoHBgcKCgoKCgoKCgoKCgoKCgoKCgoKCgoKCgoKCgoKCgoKCgoKCgoKCgoKCgoKCgoKCgoKCv/AABEIAAgAEAMB"
      "EQACEQEDEQH/xAGiAAABBQEBAQEBAQAAAAAAAAAAAQIDBAUGBwgJCgsQAAIBAwMCBAMFBQQEAAABfQECAwAEEQUSITFBBhNRYQcicRQygZGhCC"
      "NCscEVUtHwJDNicoIJChYXGBkaJSYnKCkqNDU2Nzg5OkNERUZHSElKU1RVVldYWVpjZGVmZ2hpanN0dXZ3eHl6g4SFhoeIiYqSk5SVlpeYmZqi"
      "o6Slpqeoqaqys7S1tre4ubrCw8TFxsfIycrS09TV1tfY2drh4uPk5ebn6Onq8fLz9PX29/j5+gEAAwEBAQEBAQEBAQAAAAAAAAECAwQFBgcICQ"
      "oLEQACAQIEBAMEBwUEBAABAncAAQIDEQQFITEGEkFRB2FxEyIygQgUQpGhscEJIzNS8BVictEKFiQ04SXxFxgZGiYnKCkqNTY3ODk6Q0RFRkdI"
      "SUpTVFVWV1hZWmNkZWZnaGlqc3R1dnd4eXqCg4SFhoeIiYqSk5SVlpeYmZqio6Slpqeoqaqys7S1tre4ubrCw8TFxsfIycrS09TV1tfY2dri4+"
      "Tl5ufo6ery8/T19vf4+fr/2gAMAwEAAhEDEQA/APl6vxM/1APKa/3HP8Oz/9k=");
}

std::string jpeg_of_half_width() {
  return decode_base64(
      "/9j/4AAQSkZJRgABAQAAAQABAAD/2wBDAAMCAgMCAgMDAwMEAwMEBQgFBQQEBQoHBwYIDAoMDAsKCwsNDhIQDQ4RDgsLEBYQERMUFRUVDA8X"
      "GBYUGBIUFRT/2wBDAQMEBAUEBQkFBQkUDQsNFBQUFBQUFBQUFBQUFBQUFBQUFBQUFBQUFBQUFBQUFBQUFBQUFBQUFBQUFBQUFBQUFBT/wAAR"
      "CAAIABADASEAAhEBAxEB/8QAFQABAQAAAAAAAAAAAAAAAAAABQj/xAAaEAABBQEAAAAAAAAAAAAAAAAAAgQGNoOz/8QAFQEBAQAAAAAAAAAA"
      "AAAAAAAABgn/xAAcEQAABwEBAAAAAAAAAAAAAAAAAgMFBjazc3T/2gAMAwEAAhEDEQA/AJ0AJ5VH2fRIFglsafShqUUhmdYc+C2Zh//Z");
}

std::string jpeg_of_inks() {
  return decode_base64(
      "/9j/7gAOQWRvYmUAZAAAAAAA/9sAQwADAgIDAgIDAwMDBAMDBAUIBQUEBAUKBwcGCAwKDAwLCgsLDQ4SEA0OEQ4LCxAWEBETFBUVFQwPFxgW"
      "FBgSFBUU/8AAFAgAAgAEBEMRAE0RAFkRAEsRAP/EABUAAQEAAAAAAAAAAAAAAAAAAAkI/8QAFBABAAAAAAAAAAAAAAAAAAAAAP/aAA4EQwBN"
      "AFkASwAAPwBUxVCqWW//2Q==");
}

std::string hdr_file() {
  std::string out = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 8\n";
  // 128 / 256 with exponent 129 is 1: a run of 8 for each channel.
  out += std::string("\x02\x02\x00\x08", 4);
  for (const int channel : {128, 64, 32, 129}) {
    out += static_cast<char>(128 + 8);
    out += static_cast<char>(channel);
  }
  out += std::string("\x02\x02\x00\x08", 4);
  out += '\x08';  // 8 bytes as they are
  for (int x = 0; x < 8; ++x) out += static_cast<char>(x * 8);
  for (const int channel : {0, 0, 129}) {
    out += static_cast<char>(128 + 8);
    out += static_cast<char>(channel);
  }
  return out;
}

std::string npy_file(std::string_view descr, std::string_view shape, std::string_view data, std::string_view order) {
  std::string header = "{'descr': '" + std::string(descr) + "', 'fortran_order': " + std::string(order) +
                       ", 'shape': " + std::string(shape) + ", }";
  while ((10 + header.size() + 1) % 64 != 0) header += ' ';
  header += '\n';
  return std::string("\x93NUMPY\x01\x00", 8) + u16({static_cast<uint16_t>(header.size())}) + header + std::string(data);
}

std::string base64(std::string_view bytes) {
  std::string out;
  for (size_t i = 0; i < bytes.size(); i += 3) {
    const size_t have = std::min<size_t>(3, bytes.size() - i);
    uint32_t group = 0;
    for (size_t k = 0; k < 3; ++k) group = group << 8 | (k < have ? static_cast<uint8_t>(bytes[i + k]) : 0u);
    for (size_t k = 0; k < 4; ++k) out += k <= have ? kAlphabet[group >> (18 - 6 * k) & 63] : '=';
  }
  return out;
}

std::string quad_buffer() {
  return f32({0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0}) + f32({0, 1, 1, 1, 1, 0, 0, 0}) + u16({0, 1, 2, 0, 2, 3});
}

std::string quad_json(std::string_view buffer_members) {
  return R"({"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
 "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2}]}],
 "accessors": [
  {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
  {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC2"},
  {"bufferView": 2, "componentType": 5123, "count": 6, "type": "SCALAR"}],
 "bufferViews": [
  {"buffer": 0, "byteOffset": 0, "byteLength": 48},
  {"buffer": 0, "byteOffset": 48, "byteLength": 32},
  {"buffer": 0, "byteOffset": 80, "byteLength": 12}],
 "buffers": [{"byteLength": 92)" +
         std::string(buffer_members) + "}]}";
}

std::string quad_gltf() {
  return quad_json(R"(, "uri": "data:application/octet-stream;base64,)" + base64(quad_buffer()) + "\"");
}

std::string quad_glb() { return glb_file(quad_json(""), quad_buffer()); }

std::string glb_file(std::string_view json, std::string_view binary) {
  std::string text(json);
  while (text.size() % 4 != 0) text += ' ';
  std::string data(binary);
  while (data.size() % 4 != 0) data += '\0';
  std::string body = u32({static_cast<uint32_t>(text.size()), 0x4e4f534a}) + text;
  if (!data.empty()) body += u32({static_cast<uint32_t>(data.size()), 0x004e4942}) + data;
  return "glTF" + u32({2, static_cast<uint32_t>(12 + body.size())}) + body;
}

}  // namespace dr::io::test
