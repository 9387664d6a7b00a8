// SPDX-License-Identifier: Apache-2.0
// The outermost layer of glTF: the chunks of a GLB file, JSON text of bounded depth, base64. Private to compiler/io;
// every function throws Failure.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace dr::io::gltf {

using Json = nlohmann::json;

struct Container {
  std::string_view json;
  std::span<const uint8_t> binary;  // the BIN chunk
  bool has_binary = false;
};

// The content of a .glb file, or of a .gltf file, which is JSON as a whole. The result refers to `content`.
Container open_container(std::span<const uint8_t> content);

Json parse_json(std::string_view text);

// `where` names the text in messages.
std::vector<uint8_t> decode_base64(std::string_view text, const std::string& where);

uint32_t read_u32(std::span<const uint8_t> bytes, size_t offset);

}  // namespace dr::io::gltf
