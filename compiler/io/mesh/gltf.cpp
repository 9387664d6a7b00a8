// SPDX-License-Identifier: Apache-2.0
// A strict reader of glTF 2.0 geometry, text and binary. It trusts nothing: every offset, count and index is checked by
// subtraction in 64 bits, every field for its JSON type (a wrongly typed offset is an error, not an absent one), and
// only the parts that make up triangles are looked at, so images and extras cannot do harm.
//
// It stands on the JSON parser alone. tinygltf 2.7 was weighed and left for the tests, where it judges what we write:
// it reads a GLB's binary chunk up to 8 bytes past its end, drops primitives that it cannot parse, takes wrongly typed
// fields for absent ones, and also looks for buffers in the current folder.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <limits>
#include <nlohmann/json.hpp>

#include "compiler/io/file/failure.h"
#include "compiler/io/mesh/mesh_readers.h"

namespace dr::io {
namespace {

using Json = nlohmann::json;
namespace fs = std::filesystem;

constexpr int kMaxJsonDepth = 64;  // a valid file without extras needs about 10
constexpr uint64_t kMaxNodes = uint64_t{1} << 20;

enum ComponentType : uint64_t {
  kByte = 5120,
  kUByte = 5121,
  kShort = 5122,
  kUShort = 5123,
  kUInt = 5125,
  kFloat = 5126
};
enum Mode : uint64_t { kTriangles = 4, kStrip = 5, kFan = 6 };

// --- The container ---------------------------------------------------------------------------------------------

struct Container {
  std::string_view json;
  std::span<const uint8_t> binary;  // the BIN chunk
  bool has_binary = false;
};

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

Json parse_json(std::string_view text) {
  const auto check_depth = [](int depth, Json::parse_event_t, Json&) {
    if (depth > kMaxJsonDepth) fail("JSON is nested deeper than ", kMaxJsonDepth);
    return true;
  };
  try {
    return Json::parse(text.begin(), text.end(), check_depth);
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

// --- Transforms ------------------------------------------------------------------------------------------------

// The upper three rows of an affine 4x4 matrix, row after row.
struct Affine {
  std::array<double, 12> m = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};

  double at(size_t row, size_t column) const { return m[row * 4 + column]; }
  double& at(size_t row, size_t column) { return m[row * 4 + column]; }

  bool is_identity() const { return m == Affine{}.m; }

  double determinant() const {
    return at(0, 0) * (at(1, 1) * at(2, 2) - at(1, 2) * at(2, 1)) -
           at(0, 1) * (at(1, 0) * at(2, 2) - at(1, 2) * at(2, 0)) +
           at(0, 2) * (at(1, 0) * at(2, 1) - at(1, 1) * at(2, 0));
  }

  std::array<double, 3> point(const float* p) const {
    std::array<double, 3> result;
    for (size_t r = 0; r < 3; ++r) result[r] = at(r, 0) * p[0] + at(r, 1) * p[1] + at(r, 2) * p[2] + at(r, 3);
    return result;
  }

  // The cofactor matrix times n: the inverse transpose up to a factor, and defined for flat scales too. The sign of
  // the determinant keeps the normal on the side that it was.
  std::array<double, 3> normal(const float* n) const {
    const double sign = determinant() < 0 ? -1 : 1;
    std::array<double, 3> result;
    for (size_t r = 0; r < 3; ++r) {
      const size_t r1 = (r + 1) % 3;
      const size_t r2 = (r + 2) % 3;
      double sum = 0;
      for (size_t c = 0; c < 3; ++c) {
        const size_t c1 = (c + 1) % 3;
        const size_t c2 = (c + 2) % 3;
        sum += (at(r1, c1) * at(r2, c2) - at(r1, c2) * at(r2, c1)) * n[c];
      }
      result[r] = sign * sum;
    }
    return result;
  }
};

Affine operator*(const Affine& a, const Affine& b) {
  Affine result;
  for (size_t r = 0; r < 3; ++r) {
    for (size_t c = 0; c < 4; ++c) {
      result.at(r, c) =
          a.at(r, 0) * b.at(0, c) + a.at(r, 1) * b.at(1, c) + a.at(r, 2) * b.at(2, c) + (c == 3 ? a.at(r, 3) : 0);
    }
  }
  return result;
}

// --- The reader ------------------------------------------------------------------------------------------------

// An accessor's elements without gaps, sparse substitution done.
struct Elements {
  std::vector<uint8_t> bytes;
  uint64_t count = 0;
  uint64_t components = 1;
  uint64_t component_type = kFloat;
  bool normalized = false;
};

class GltfReader {
 public:
  GltfReader(std::span<const uint8_t> content, const std::string& path)
      : container_(open_container(content)), root_(parse_json(container_.json)), path_(path) {}

  Mesh read(RequiredAttribute required) {
    required_ = required;
    if (!root_.is_object()) fail("the root of the JSON is not an object");
    check_version();
    check_extensions();
    for (const Instance& instance : instances()) add_mesh(instance);
    if (mesh_.indices.empty()) fail("the scene has no triangles");
    if (all_have_uv_)
      mesh_.uv_indices = mesh_.indices;
    else
      mesh_.uv.clear();
    if (!all_have_normals_) mesh_.normals.clear();
    if (!any_has_colors_) mesh_.colors.clear();
    return std::move(mesh_);
  }

 private:
  struct Instance {
    uint64_t mesh;
    Affine transform;
  };

  // Fields. `where` names the object in messages: "accessors[2]".

  static const Json* find(const Json& object, const char* key) {
    const auto it = object.find(key);
    return it == object.end() ? nullptr : &*it;
  }

  static std::string found(const Json& value) {
    if (value.is_structured()) return value.type_name();
    return in_quotes(value.dump(-1, ' ', false, Json::error_handler_t::replace));
  }

  static uint64_t to_uint(const Json& value, const std::string& where) {
    if (value.is_number_unsigned()) return value.get<uint64_t>();
    // Some writers print 3.0.
    if (value.is_number_float()) {
      const double number = value.get<double>();
      if (number >= 0 && number <= 9007199254740992.0 && number == std::floor(number)) {
        return static_cast<uint64_t>(number);
      }
    }
    fail(where, ": expected a non-negative integer, found ", found(value));
  }

  static std::optional<uint64_t> optional_uint(const Json& object, const char* key, const std::string& where) {
    const Json* value = find(object, key);
    if (!value) return std::nullopt;
    return to_uint(*value, cat(where, ".", key));
  }

  static uint64_t required_uint(const Json& object, const char* key, const std::string& where) {
    const auto value = optional_uint(object, key, where);
    if (!value) fail(where, ": ", in_quotes(key), " is missing");
    return *value;
  }

  static const std::string* optional_string(const Json& object, const char* key, const std::string& where) {
    const Json* value = find(object, key);
    if (!value) return nullptr;
    if (!value->is_string()) fail(where, ".", key, ": expected a string, found ", found(*value));
    return value->get_ptr<const std::string*>();
  }

  static const Json& required_object(const Json& object, const char* key, const std::string& where) {
    const Json* value = find(object, key);
    if (!value) fail(where, ": ", in_quotes(key), " is missing");
    if (!value->is_object()) fail(where, ".", key, ": expected an object, found ", found(*value));
    return *value;
  }

  // The list under `key`, or an empty one.
  static const Json& list(const Json& object, const char* key, const std::string& where) {
    static const Json kEmpty = Json::array();
    const Json* value = find(object, key);
    if (!value) return kEmpty;
    if (!value->is_array()) fail(where, key, ": expected a list, found ", found(*value));
    return *value;
  }

  // Object `index` of a list at the root. `by` names the reference for the message.
  const Json& item(const char* key, uint64_t index, const std::string& by) const {
    const Json& items = list(root_, key, "");
    if (index >= items.size()) {
      fail(by, ": there is no ", key, "[", index, "], the file has ", items.size());
    }
    const Json& value = items[static_cast<size_t>(index)];
    if (!value.is_object()) fail(key, "[", index, "]: expected an object, found ", found(value));
    return value;
  }

  template <size_t N>
  static std::optional<std::array<double, N>> optional_numbers(const Json& object, const char* key,
                                                               const std::string& where) {
    const Json* value = find(object, key);
    if (!value) return std::nullopt;
    if (!value->is_array() || value->size() != N) {
      fail(where, ".", key, ": expected ", N, " numbers, found ",
           value->is_array() ? cat(value->size()) : found(*value));
    }
    std::array<double, N> numbers;
    for (size_t i = 0; i < N; ++i) {
      const Json& number = (*value)[i];
      if (!number.is_number()) fail(where, ".", key, "[", i, "]: expected a number, found ", found(number));
      numbers[i] = number.get<double>();
    }
    return numbers;
  }

  void check_version() const {
    const Json& asset = required_object(root_, "asset", "the file");
    const std::string* version = optional_string(asset, "version", "asset");
    if (!version) fail("asset: 'version' is missing");
    if (!version->starts_with("2.")) fail("asset.version: ", in_quotes(*version), ", only 2.x is read");
    const std::string* least = optional_string(asset, "minVersion", "asset");
    if (least && *least != "2.0") fail("asset.minVersion: ", in_quotes(*least), ", only 2.0 is read");
  }

  void check_extensions() const {
    // Those that change looks, not triangles.
    constexpr std::string_view kHarmless[] = {"KHR_materials_", "KHR_lights_punctual",   "KHR_texture_basisu",
                                              "KHR_xmp",        "KHR_animation_pointer", "EXT_texture_"};
    for (const Json& name : list(root_, "extensionsRequired", "")) {
      if (!name.is_string()) fail("extensionsRequired: expected strings, found ", found(name));
      const auto& text = name.get_ref<const std::string&>();
      const bool harmless = std::any_of(std::begin(kHarmless), std::end(kHarmless),
                                        [&](std::string_view prefix) { return text.starts_with(prefix); });
      if (!harmless) fail("it requires the extension ", in_quotes(text), ", which is not read");
    }
  }

  // Nodes.

  Affine local_transform(const Json& node, const std::string& where) const {
    Affine result;
    if (const auto matrix = optional_numbers<16>(node, "matrix", where)) {
      if ((*matrix)[3] != 0 || (*matrix)[7] != 0 || (*matrix)[11] != 0 || (*matrix)[15] != 1) {
        fail(where, ".matrix: the last row is not 0 0 0 1");
      }
      for (size_t r = 0; r < 3; ++r) {
        for (size_t c = 0; c < 4; ++c) result.at(r, c) = (*matrix)[c * 4 + r];
      }
      return result;
    }
    const auto t = optional_numbers<3>(node, "translation", where).value_or(std::array<double, 3>{0, 0, 0});
    const auto s = optional_numbers<3>(node, "scale", where).value_or(std::array<double, 3>{1, 1, 1});
    auto q = optional_numbers<4>(node, "rotation", where).value_or(std::array<double, 4>{0, 0, 0, 1});
    const double length = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    if (!(length > 1e-6) || !std::isfinite(length)) fail(where, ".rotation: not a unit quaternion");
    for (double& part : q) part /= length;
    const auto [x, y, z, w] = q;
    const std::array<double, 9> rotation = {1 - 2 * (y * y + z * z), 2 * (x * y - z * w),     2 * (x * z + y * w),  //
                                            2 * (x * y + z * w),     1 - 2 * (x * x + z * z), 2 * (y * z - x * w),  //
                                            2 * (x * z - y * w),     2 * (y * z + x * w),     1 - 2 * (x * x + y * y)};
    for (size_t r = 0; r < 3; ++r) {
      for (size_t c = 0; c < 3; ++c) result.at(r, c) = rotation[r * 3 + c] * s[c];
      result.at(r, 3) = t[r];
    }
    return result;
  }

  std::vector<uint64_t> node_indices(const Json& object, const char* key, const std::string& where) const {
    std::vector<uint64_t> indices;
    for (const Json& index : list(object, key, cat(where, "."))) {
      indices.push_back(to_uint(index, cat(where, ".", key)));
      item("nodes", indices.back(), cat(where, ".", key));
    }
    return indices;
  }

  // The nodes to start from: the default scene's, else the first scene's, else every node without a parent.
  std::vector<uint64_t> root_nodes() const {
    const Json& scenes = list(root_, "scenes", "");
    const auto chosen = optional_uint(root_, "scene", "the file");
    if (chosen || !scenes.empty()) {
      const uint64_t scene = chosen.value_or(0);
      return node_indices(item("scenes", scene, "scene"), "nodes", cat("scenes[", scene, "]"));
    }
    const size_t count = list(root_, "nodes", "").size();
    std::vector<bool> has_parent(count);
    for (size_t i = 0; i < count; ++i) {
      const std::string where = cat("nodes[", i, "]");
      for (const uint64_t child : node_indices(item("nodes", i, "nodes"), "children", where)) {
        has_parent[static_cast<size_t>(child)] = true;
      }
    }
    std::vector<uint64_t> roots;
    for (size_t i = 0; i < count; ++i) {
      if (!has_parent[i]) roots.push_back(i);
    }
    return roots;
  }

  // Every use of a mesh, in the order of a walk from parents to children.
  std::vector<Instance> instances() const {
    const Json& nodes = list(root_, "nodes", "");
    if (nodes.size() > kMaxNodes) fail("nodes: ", nodes.size(), " of them, the limit is ", kMaxNodes);
    std::vector<Instance> found;
    if (nodes.empty() && list(root_, "scenes", "").empty()) {
      // A bare library of meshes: take them as they are.
      for (size_t i = 0; i < list(root_, "meshes", "").size(); ++i) found.push_back({i, {}});
      return found;
    }
    struct Entry {
      uint64_t node;
      Affine parent;
    };
    std::vector<Entry> stack;
    std::vector<bool> seen(nodes.size());
    const std::vector<uint64_t> roots = root_nodes();
    for (auto it = roots.rbegin(); it != roots.rend(); ++it) stack.push_back({*it, {}});
    while (!stack.empty()) {
      const Entry entry = stack.back();
      stack.pop_back();
      const std::string where = cat("nodes[", entry.node, "]");
      // A node has one parent at most, so that a second visit means a cycle or a shared child.
      if (seen[static_cast<size_t>(entry.node)]) fail(where, ": it is reached twice, nodes must form a tree");
      seen[static_cast<size_t>(entry.node)] = true;
      const Json& node = item("nodes", entry.node, "nodes");
      const Affine transform = entry.parent * local_transform(node, where);
      if (const auto mesh = optional_uint(node, "mesh", where)) {
        item("meshes", *mesh, cat(where, ".mesh"));
        found.push_back({*mesh, transform});
      }
      const std::vector<uint64_t> children = node_indices(node, "children", where);
      for (auto it = children.rbegin(); it != children.rend(); ++it) stack.push_back({*it, transform});
    }
    return found;
  }

  // Buffers.

  // The file that a relative URI names, which must lie in the folder of the glTF file.
  std::string resolve_uri(const std::string& uri, const std::string& where) const {
    std::string name;
    for (size_t i = 0; i < uri.size(); ++i) {
      if (uri[i] != '%') {
        name += uri[i];
        continue;
      }
      const auto digit = [&](size_t at) -> int {
        if (at >= uri.size()) return -1;
        const char c = uri[at];
        if (c >= '0' && c <= '9') return c - '0';
        if (c >= 'a' && c <= 'f') return c - 'a' + 10;
        if (c >= 'A' && c <= 'F') return c - 'A' + 10;
        return -1;
      };
      const int high = digit(i + 1);
      const int low = digit(i + 2);
      if (high < 0 || low < 0) fail(where, ": ", in_quotes(uri), " has a bad % escape");
      name += static_cast<char>(high * 16 + low);
      i += 2;
    }
    const auto refuse = [&](std::string_view why) { fail(where, ": ", in_quotes(uri), " ", why); };
    if (name.empty()) refuse("names no file");
    if (name.find('\0') != std::string::npos) refuse("holds a zero byte");
    if (name.find('\\') != std::string::npos) refuse("holds a backslash");
    if (const size_t colon = name.find(':'); colon != std::string::npos && colon < name.find('/')) {
      refuse("has a scheme, only 'data:' and files in the folder of the glTF file are read");
    }
    const fs::path relative(name);
    const bool climbs = std::find(relative.begin(), relative.end(), fs::path("..")) != relative.end();
    if (relative.is_absolute() || climbs) refuse("leads out of the folder of the glTF file");

    // A link may lead out too.
    fs::path folder = fs::path(path_).parent_path();
    if (folder.empty()) folder = ".";
    std::error_code error;
    const fs::path base = fs::weakly_canonical(folder, error);
    if (error) refuse(error.message());
    const fs::path full = fs::weakly_canonical(folder / relative, error);
    if (error) refuse(error.message());
    const auto [end, ignored] = std::mismatch(base.begin(), base.end(), full.begin(), full.end());
    if (end != base.end()) refuse("leads out of the folder of the glTF file");
    return full.string();
  }

  std::span<const uint8_t> buffer(uint64_t index, const std::string& by) {
    const Json& description = item("buffers", index, by);
    const std::string where = cat("buffers[", index, "]");
    const uint64_t length = required_uint(description, "byteLength", where);
    if (loaded_.empty()) loaded_.resize(list(root_, "buffers", "").size());
    std::optional<Bytes>& cached = loaded_[static_cast<size_t>(index)];
    const std::string* uri = optional_string(description, "uri", where);
    std::span<const uint8_t> bytes;
    if (!uri) {
      if (index != 0 || !container_.has_binary) fail(where, ": 'uri' is missing");
      bytes = container_.binary;
    } else {
      if (!cached) cached = load_uri(*uri, cat(where, ".uri"));
      bytes = *cached;
    }
    if (length == 0) fail(where, ".byteLength: it is 0");
    if (length > bytes.size()) {
      fail(where, ".byteLength: it says ", length, " bytes, there are ", bytes.size());
    }
    return bytes.first(static_cast<size_t>(length));
  }

  Bytes load_uri(const std::string& uri, const std::string& where) const {
    if (uri.starts_with("data:")) {
      const size_t comma = uri.find(',');
      if (comma == std::string::npos) fail(where, ": there is no ',' after 'data:'");
      const std::string_view header = std::string_view(uri).substr(5, comma - 5);
      if (!header.ends_with(";base64")) fail(where, ": a data URI must be base64, found ", in_quotes(header));
      return decode_base64(std::string_view(uri).substr(comma + 1), where);
    }
    const std::string file = resolve_uri(uri, where);
    try {
      return read_file(file);
    } catch (const Failure& failure) {
      fail(where, ": cannot read ", in_quotes(uri), ": ", failure.what());
    }
  }

  struct View {
    std::span<const uint8_t> bytes;
    std::optional<uint64_t> stride;
  };

  View buffer_view(uint64_t index, const std::string& by) {
    const Json& description = item("bufferViews", index, by);
    const std::string where = cat("bufferViews[", index, "]");
    const std::span<const uint8_t> bytes = buffer(required_uint(description, "buffer", where), cat(where, ".buffer"));
    const uint64_t offset = optional_uint(description, "byteOffset", where).value_or(0);
    const uint64_t length = required_uint(description, "byteLength", where);
    if (offset > bytes.size() || length > bytes.size() - offset) {
      fail(where, ": ", length, " bytes from byte ", offset, " do not fit the buffer of ", bytes.size());
    }
    if (length == 0) fail(where, ".byteLength: it is 0");
    return {bytes.subspan(static_cast<size_t>(offset), static_cast<size_t>(length)),
            optional_uint(description, "byteStride", where)};
  }

  // Accessors.

  static uint64_t component_size(uint64_t type, const std::string& where) {
    switch (type) {
      case kByte:
      case kUByte: return 1;
      case kShort:
      case kUShort: return 2;
      case kUInt:
      case kFloat: return 4;
      default: fail(where, ".componentType: ", type, " is not one of 5120, 5121, 5122, 5123, 5125, 5126");
    }
  }

  static uint64_t component_count(const std::string& type, const std::string& where) {
    constexpr std::pair<std::string_view, uint64_t> kTypes[] = {{"SCALAR", 1}, {"VEC2", 2}, {"VEC3", 3}, {"VEC4", 4},
                                                                {"MAT2", 4},   {"MAT3", 9}, {"MAT4", 16}};
    for (const auto& [name, count] : kTypes) {
      if (type == name) return count;
    }
    fail(where, ".type: ", in_quotes(type), " is not an accessor type");
  }

  // Copies `count` elements of `size` bytes, `stride` apart, out of a view.
  static void copy_elements(const View& view, uint64_t offset, uint64_t stride, uint64_t size, uint64_t count,
                            uint8_t* out, const std::string& where) {
    const uint64_t have = view.bytes.size();
    const bool fits = offset <= have && size <= have - offset && (count - 1) <= (have - offset - size) / stride;
    if (!fits) {
      fail(where, ": ", counted(static_cast<int64_t>(count), "element", "elements"), " of ", size, " bytes, ", stride,
           " apart from byte ", offset, ", do not fit the buffer view of ", have);
    }
    const uint8_t* from = view.bytes.data() + offset;
    if (stride == size) {
      std::memcpy(out, from, static_cast<size_t>(size * count));
      return;
    }
    for (uint64_t i = 0; i < count; ++i) std::memcpy(out + i * size, from + i * stride, static_cast<size_t>(size));
  }

  Elements elements(uint64_t index, uint64_t limit, const std::string& by) {
    const Json& accessor = item("accessors", index, by);
    const std::string where = cat("accessors[", index, "]");
    Elements result;
    result.component_type = required_uint(accessor, "componentType", where);
    const uint64_t scalar = component_size(result.component_type, where);
    const std::string* type = optional_string(accessor, "type", where);
    if (!type) fail(where, ": 'type' is missing");
    result.components = component_count(*type, where);
    if (type->starts_with("MAT")) fail(where, ".type: a matrix is not a vertex attribute");
    result.count = required_uint(accessor, "count", where);
    if (result.count == 0) fail(where, ".count: it is 0");
    if (result.count > limit) fail(where, ".count: ", result.count, " is over the limit of ", limit);
    if (const Json* normalized = find(accessor, "normalized")) {
      if (!normalized->is_boolean()) fail(where, ".normalized: expected a boolean, found ", found(*normalized));
      result.normalized = normalized->get<bool>();
    }
    const uint64_t size = scalar * result.components;
    const uint64_t offset = optional_uint(accessor, "byteOffset", where).value_or(0);
    const auto view_index = optional_uint(accessor, "bufferView", where);
    if (view_index) {
      const View view = buffer_view(*view_index, cat(where, ".bufferView"));
      const uint64_t stride = view.stride.value_or(size);
      if (stride < size || stride > 252) {
        fail("bufferViews[", *view_index, "].byteStride: ", stride, " is not in ", size, " to 252");
      }
      // Checked before the allocation: a count that the view cannot hold must not cost memory.
      if (result.count - 1 > view.bytes.size() / stride) {
        fail(where, ".count: ", result.count, " elements, ", stride, " bytes apart, do not fit the buffer view of ",
             view.bytes.size());
      }
      result.bytes.resize(static_cast<size_t>(size * result.count));
      copy_elements(view, offset, stride, size, result.count, result.bytes.data(), where);
    } else {
      result.bytes.resize(static_cast<size_t>(size * result.count));  // without a view, all are zero
    }
    if (const Json* sparse = find(accessor, "sparse")) {
      if (!sparse->is_object()) fail(where, ".sparse: expected an object, found ", found(*sparse));
      substitute(*sparse, size, result, cat(where, ".sparse"));
    } else if (!view_index) {
      fail(where, ": it has neither 'bufferView' nor 'sparse'");
    }
    return result;
  }

  // Overwrites the elements that a sparse accessor lists.
  void substitute(const Json& sparse, uint64_t size, Elements& target, const std::string& where) {
    const uint64_t count = required_uint(sparse, "count", where);
    if (count == 0 || count > target.count) {
      fail(where, ".count: ", count, " is not in 1 to the accessor's ", target.count);
    }
    const Json& indices = required_object(sparse, "indices", where);
    const Json& values = required_object(sparse, "values", where);
    const std::string indices_where = cat(where, ".indices");
    const std::string values_where = cat(where, ".values");

    const uint64_t type = required_uint(indices, "componentType", indices_where);
    if (type != kUByte && type != kUShort && type != kUInt) {
      fail(indices_where, ".componentType: ", type, " is not one of 5121, 5123, 5125");
    }
    const uint64_t index_size = component_size(type, indices_where);
    std::vector<uint8_t> raw_indices(static_cast<size_t>(index_size * count));
    copy_elements(buffer_view(required_uint(indices, "bufferView", indices_where), cat(indices_where, ".bufferView")),
                  optional_uint(indices, "byteOffset", indices_where).value_or(0), index_size, index_size, count,
                  raw_indices.data(), indices_where);
    std::vector<uint8_t> raw_values(static_cast<size_t>(size * count));
    copy_elements(buffer_view(required_uint(values, "bufferView", values_where), cat(values_where, ".bufferView")),
                  optional_uint(values, "byteOffset", values_where).value_or(0), size, size, count, raw_values.data(),
                  values_where);
    uint64_t previous = 0;
    for (uint64_t i = 0; i < count; ++i) {
      const uint64_t index = unsigned_at(raw_indices, type, i);
      if (index >= target.count) {
        fail(indices_where, ": index ", i, " is ", index, ", the accessor has ", target.count, " elements");
      }
      if (i > 0 && index <= previous) {
        fail(indices_where, ": index ", i, " is ", index, " after ", previous, ", they must increase");
      }
      previous = index;
      std::memcpy(target.bytes.data() + index * size, raw_values.data() + i * size, static_cast<size_t>(size));
    }
  }

  static uint64_t unsigned_at(const std::vector<uint8_t>& bytes, uint64_t type, uint64_t i) {
    const uint8_t* p = bytes.data();
    switch (type) {
      case kUByte: return p[i];
      case kUShort: return static_cast<uint64_t>(p[i * 2]) | static_cast<uint64_t>(p[i * 2 + 1]) << 8;
      default: return read_u32(bytes, static_cast<size_t>(i * 4));
    }
  }

  // Scalars as floats: as they are, or normalized integers.
  static std::vector<float> to_floats(const Elements& elements, const std::string& where) {
    const size_t count = static_cast<size_t>(elements.count * elements.components);
    std::vector<float> values(count);
    for (size_t i = 0; i < count; ++i) {
      switch (elements.component_type) {
        case kFloat: {
          const uint32_t bits = read_u32(elements.bytes, i * 4);
          std::memcpy(&values[i], &bits, 4);
          break;
        }
        case kUByte: values[i] = static_cast<float>(elements.bytes[i]) / 255.0f; break;
        case kUShort: values[i] = static_cast<float>(unsigned_at(elements.bytes, kUShort, i)) / 65535.0f; break;
        default: fail(where, ": unexpected component type");
      }
      if (!std::isfinite(values[i])) {
        fail(where, ": element ", i / elements.components, " holds ",
             std::isnan(values[i]) ? "NaN" : "an infinite value");
      }
    }
    return values;
  }

  struct Expected {
    uint64_t least_components;
    uint64_t most_components;
    bool normalized_integers;  // unsigned 8 and 16-bit ones, as texture coordinates and colours may be
    uint64_t count;            // 0: any
  };

  Elements attribute_elements(uint64_t index, const Expected& expected, const std::string& where) {
    Elements result = elements(index, static_cast<uint64_t>(kMaxVertices), where);
    const bool integer = expected.normalized_integers && result.normalized &&
                         (result.component_type == kUByte || result.component_type == kUShort);
    if (result.component_type != kFloat && !integer) {
      fail(where, ": component type ", result.component_type, result.normalized ? " (normalized)" : "",
           expected.normalized_integers ? ", expected floats or normalized unsigned integers" : ", expected floats");
    }
    if (result.components < expected.least_components || result.components > expected.most_components) {
      const std::string range = expected.least_components == expected.most_components
                                    ? cat(expected.least_components)
                                    : cat(expected.least_components, " or ", expected.most_components);
      fail(where, ": ", result.components, " components, expected ", range);
    }
    if (expected.count != 0 && result.count != expected.count) {
      fail(where, ": ", result.count, " elements, but POSITION has ", expected.count);
    }
    return result;
  }

  // Primitives.

  void add_mesh(const Instance& instance) {
    const std::string where = cat("meshes[", instance.mesh, "]");
    const Json& mesh = item("meshes", instance.mesh, "nodes");
    const Json& primitives = list(mesh, "primitives", cat(where, "."));
    if (primitives.empty()) fail(where, ": it has no primitives");
    for (size_t i = 0; i < primitives.size(); ++i) {
      const std::string primitive_where = cat(where, ".primitives[", i, "]");
      if (!primitives[i].is_object()) {
        fail(primitive_where, ": expected an object, found ", found(primitives[i]));
      }
      add_primitive(primitives[i], instance.transform, primitive_where);
    }
  }

  void add_primitive(const Json& primitive, const Affine& transform, const std::string& where) {
    const uint64_t mode = optional_uint(primitive, "mode", where).value_or(kTriangles);
    if (mode > kFan) fail(where, ".mode: ", mode, " is not in 0 to 6");
    if (mode < kTriangles) fail(where, ".mode: ", mode, " is points or lines, only triangles are read");

    const Json& attributes = required_object(primitive, "attributes", where);
    const std::string attributes_where = cat(where, ".attributes");
    const auto attribute = [&](const char* name) { return optional_uint(attributes, name, attributes_where); };
    const auto named = [&](const char* name) { return cat(attributes_where, ".", name); };

    const auto position = attribute("POSITION");
    if (!position) fail(where, ": there is no POSITION");
    const std::vector<float> positions =
        to_floats(attribute_elements(*position, {3, 3, false, 0}, named("POSITION")), named("POSITION"));
    const size_t count = positions.size() / 3;
    const size_t base = mesh_.positions.size() / 3;
    if (base + count > static_cast<size_t>(kMaxVertices)) fail("the scene has more than ", kMaxVertices, " vertices");
    add_positions(positions, transform, named("POSITION"));

    const auto need = [&](MeshAttribute wanted, bool present, const char* name) {
      if (!present && required_ == wanted) fail(where, ": there is no ", name);
    };
    const auto uv = attribute("TEXCOORD_0");
    need(MeshAttribute::Uv, uv.has_value(), "TEXCOORD_0");
    need(MeshAttribute::UvIndices, uv.has_value(), "TEXCOORD_0");
    if (uv) {
      const std::vector<float> values =
          to_floats(attribute_elements(*uv, {2, 2, true, count}, named("TEXCOORD_0")), named("TEXCOORD_0"));
      mesh_.uv.insert(mesh_.uv.end(), values.begin(), values.end());
    } else {
      all_have_uv_ = false;
    }

    const auto normal = attribute("NORMAL");
    need(MeshAttribute::Normal, normal.has_value(), "NORMAL");
    if (normal) {
      add_normals(to_floats(attribute_elements(*normal, {3, 3, false, count}, named("NORMAL")), named("NORMAL")),
                  transform);
    } else {
      all_have_normals_ = false;
    }

    const auto color = attribute("COLOR_0");
    need(MeshAttribute::Color, color.has_value(), "COLOR_0");
    if (color) {
      const Elements colors = attribute_elements(*color, {3, 4, true, count}, named("COLOR_0"));
      const std::vector<float> values = to_floats(colors, named("COLOR_0"));
      const size_t channels = static_cast<size_t>(colors.components);
      for (size_t i = 0; i < count; ++i) {
        for (size_t k = 0; k < 4; ++k) mesh_.colors.push_back(k < channels ? values[i * channels + k] : 1.0f);
      }
      any_has_colors_ = true;
    } else {
      // The factor of a vertex without a colour is 1.
      mesh_.colors.insert(mesh_.colors.end(), count * 4, 1.0f);
    }

    add_triangles(primitive, mode, count, base, transform.determinant() < 0, where);
  }

  void add_positions(const std::vector<float>& positions, const Affine& transform, const std::string& where) {
    if (transform.is_identity()) {  // the very bits of the file
      mesh_.positions.insert(mesh_.positions.end(), positions.begin(), positions.end());
      return;
    }
    for (size_t i = 0; i < positions.size(); i += 3) {
      for (const double value : transform.point(&positions[i])) {
        const auto rounded = static_cast<float>(value);
        if (!std::isfinite(rounded)) fail(where, ": element ", i / 3, " leaves the range of a float when placed");
        mesh_.positions.push_back(rounded);
      }
    }
  }

  void add_normals(const std::vector<float>& normals, const Affine& transform) {
    for (size_t i = 0; i < normals.size(); i += 3) {
      const std::array<double, 3> n = transform.normal(&normals[i]);
      const double length = std::hypot(n[0], n[1], n[2]);
      const bool usable = length > 0 && std::isfinite(length);
      for (size_t k = 0; k < 3; ++k) {
        mesh_.normals.push_back(usable ? static_cast<float>(n[k] / length) : (k == 2 ? 1.0f : 0.0f));
      }
    }
  }

  void add_triangles(const Json& primitive, uint64_t mode, size_t vertex_count, size_t base, bool mirrored,
                     const std::string& where) {
    std::vector<uint32_t> order;
    const auto indices = optional_uint(primitive, "indices", where);
    if (indices) {
      const std::string indices_where = cat(where, ".indices");
      const Elements raw = elements(*indices, static_cast<uint64_t>(kMaxTriangles) * 3, indices_where);
      const uint64_t type = raw.component_type;
      if (raw.components != 1 || (type != kUByte && type != kUShort && type != kUInt)) {
        fail(indices_where, ": expected unsigned scalars, found ", raw.components, " x component type ", type);
      }
      order.resize(static_cast<size_t>(raw.count));
      for (size_t i = 0; i < order.size(); ++i) {
        const uint64_t index = unsigned_at(raw.bytes, type, i);
        if (index >= vertex_count) {
          fail(indices_where, ": index ", i, " is ", index, ", the primitive has ", vertex_count, " vertices");
        }
        order[i] = static_cast<uint32_t>(index);
      }
    } else {
      order.resize(vertex_count);
      for (size_t i = 0; i < vertex_count; ++i) order[i] = static_cast<uint32_t>(i);
    }

    if (mode == kTriangles && order.size() % 3 != 0) {
      fail(where, ": ", order.size(), " indices are not a multiple of 3");
    }
    if (order.size() < 3) fail(where, ": ", order.size(), " indices make no triangle");
    const size_t triangles = mode == kTriangles ? order.size() / 3 : order.size() - 2;
    if (mesh_.indices.size() / 3 + triangles > static_cast<size_t>(kMaxTriangles)) {
      fail("the scene has more than ", kMaxTriangles, " triangles");
    }
    for (size_t t = 0; t < triangles; ++t) {
      size_t a = t;
      size_t b = t + 1;
      size_t c = t + 2;
      if (mode == kTriangles) {
        a = t * 3;
        b = a + 1;
        c = a + 2;
      } else if (mode == kStrip) {
        if (t % 2 == 1) std::swap(b, c);  // every other triangle of a strip is wound the other way
      } else {
        // The specification's order: the hub comes last.
        a = t + 1;
        b = t + 2;
        c = 0;
      }
      if (mirrored) std::swap(b, c);
      for (const size_t corner : {a, b, c}) mesh_.indices.push_back(static_cast<int32_t>(base + order[corner]));
    }
  }

  Container container_;
  Json root_;
  std::string path_;
  RequiredAttribute required_;
  std::vector<std::optional<Bytes>> loaded_;
  Mesh mesh_;
  bool all_have_uv_ = true;
  bool all_have_normals_ = true;
  bool any_has_colors_ = false;
};

}  // namespace

Mesh parse_gltf(std::span<const uint8_t> content, const std::string& path, RequiredAttribute required) {
  return GltfReader(content, path).read(required);
}

}  // namespace dr::io
