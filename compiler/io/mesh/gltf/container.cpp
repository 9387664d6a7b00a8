// SPDX-License-Identifier: Apache-2.0
#include "compiler/io/mesh/gltf/container.h"

#include <array>
#include <cstring>

#include "compiler/io/file/failure.h"
#include "compiler/io/file/file.h"

namespace dr::io::gltf {
namespace {

constexpr int kMaxJsonDepth = 64;  // a valid file without extras needs about 10

}  // namespace

uint32_t read_u32(std::span<const uint8_t> bytes, size_t offset) {
  return static_cast<uint32_t>(bytes[offset]) | static_cast<uint32_t>(bytes[offset + 1]) << 8 |
         static_cast<uint32_t>(bytes[offset + 2]) << 16 | static_cast<uint32_t>(bytes[offset + 3]) << 24;
}

Container open_container(std::span<const uint8_t> content) {
  constexpr uint32_t kJsonChunk = 0x4e4f534a;
  constexpr uint32_t kBinaryChunk = 0x004e4942;
  if (content.empty()) fail("the file is empty");
  if (content.size() < 4 || std::memcmp(content.data(), "glTF", 4) != 0) return {as_text(content), {}, false};

  if (content.size() < 12) fail("a GLB header has 12 bytes, the file has ", content.size());
  const uint32_t version = read_u32(content, 4);
  if (version != 2) fail("byte 4: GLB version ", version, ", only 2 is read");
  const uint32_t length = read_u32(content, 8);
  if (length != content.size()) {
    fail("byte 8: the header says ", length, " bytes, the file has ", content.size());
  }
  Container container;
  size_t offset = 12;
  for (int chunk = 0; offset < content.size(); ++chunk) {
    if (content.size() - offset < 8) fail("byte ", offset, ": the header of chunk ", chunk, " is cut short");
    const uint32_t size = read_u32(content, offset);
    const uint32_t type = read_u32(content, offset + 4);
    const size_t left = content.size() - offset - 8;
    if (size > left) fail("byte ", offset, ": chunk ", chunk, " has ", size, " bytes, only ", left, " are left");
    const std::span<const uint8_t> data = content.subspan(offset + 8, size);
    if (chunk == 0) {
      if (type != kJsonChunk) fail("byte ", offset + 4, ": the first chunk is not JSON");
      container.json = as_text(data);
    } else if (chunk == 1 && type == kBinaryChunk) {
      container.binary = data;
      container.has_binary = true;
    }
    offset += 8 + size;
    // Chunks are padded to 4 bytes; a writer that forgot the last padding does no harm.
    if (size % 4 != 0 && offset < content.size())
      fail("byte ", offset, ": chunk ", chunk, " does not end at a multiple of 4");
  }
  if (container.json.empty()) fail("there is no JSON chunk");
  return container;
}

namespace {

// The parser itself could be told to watch the depth, but then each list takes time with the square of its length.
void check_depth(std::string_view text) {
  int depth = 0;
  bool quoted = false;
  for (size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (quoted) {
      if (c == '\\') ++i;
      if (c == '"') quoted = false;
      continue;
    }
    if (c == '"') quoted = true;
    if (c == '[' || c == '{') ++depth;
    if (c == ']' || c == '}') --depth;
    if (depth > kMaxJsonDepth) fail("JSON is nested deeper than ", kMaxJsonDepth);
  }
}

}  // namespace

Json parse_json(std::string_view text) {
  check_depth(text);
  try {
    return Json::parse(text.begin(), text.end());
  } catch (const Json::parse_error& error) {
    fail("byte ", error.byte, ": not valid JSON");
  } catch (const Json::exception&) {
    fail("not valid JSON: a number does not fit");
  }
}

std::vector<uint8_t> decode_base64(std::string_view text, const std::string& where) {
  static constexpr std::string_view kAlphabet = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::array<int8_t, 256> value;
  value.fill(-1);
  for (size_t i = 0; i < kAlphabet.size(); ++i) value[static_cast<uint8_t>(kAlphabet[i])] = static_cast<int8_t>(i);

  size_t padding = 0;
  while (padding < 2 && text.ends_with('=')) {
    text.remove_suffix(1);
    ++padding;
  }
  if (text.size() % 4 == 1 || (padding != 0 && (text.size() + padding) % 4 != 0)) {
    fail(where, ": base64 of ", text.size() + padding, " characters is cut short");
  }
  std::vector<uint8_t> bytes;
  bytes.reserve(text.size() / 4 * 3 + 2);
  uint32_t bits = 0;
  int count = 0;
  for (size_t i = 0; i < text.size(); ++i) {
    const int8_t digit = value[static_cast<uint8_t>(text[i])];
    if (digit < 0) fail(where, ": character ", i, " of the base64 text is ", in_quotes(text.substr(i, 1)));
    bits = bits << 6 | static_cast<uint32_t>(digit);
    count += 6;
    if (count >= 8) {
      count -= 8;
      bytes.push_back(static_cast<uint8_t>(bits >> count));
      bits &= (1u << count) - 1;
    }
  }
  return bytes;
}

}  // namespace dr::io::gltf
