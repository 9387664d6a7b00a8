// SPDX-License-Identifier: Apache-2.0
// How tinygltf gets to see a file. Our own code opens the container, checks the JSON and loads the buffers; tinygltf
// gets that JSON with each URI replaced by a name of ours, and finds the bytes behind such a name through its file
// callbacks. So it opens no file, and three faults of version 2.7 stay out of reach: it reads a GLB's binary chunk past
// its end, takes buffers from the current folder where the file's own has none, and refuses a buffer file that is
// longer than said.
#include "compiler/io/mesh/gltf/document.h"

#include <charconv>
#include <map>

#include "compiler/io/file/failure.h"
#include "compiler/io/mesh/gltf/check.h"
#include "compiler/io/mesh/gltf/uri.h"

namespace dr::io::gltf {
namespace {

constexpr std::string_view kBuffer = "buffer-";

Json* member(Json& root, const char* key) {
  const auto it = root.find(key);
  return it == root.end() ? nullptr : &*it;
}

// Loads every buffer, cut to the length that the file gives, and puts our names in place of the URIs.
std::vector<Bytes> take_buffers(Json& root, const Container& container, const std::string& path) {
  std::vector<Bytes> buffers;
  std::map<std::string, Bytes> files;  // by URI: several buffers may lie in one file
  uint64_t total = 0;
  Json* list = member(root, "buffers");
  for (size_t i = 0; list && i < list->size(); ++i) {
    Json& buffer = (*list)[i];
    const std::string where = cat("buffers[", i, "]");
    const auto length = buffer["byteLength"].get<uint64_t>();
    total += length;
    if (total > kMaxBufferBytes) fail("the buffers have more than ", kMaxBufferBytes, " bytes together");
    std::span<const uint8_t> bytes;
    if (const Json* uri = member(buffer, "uri")) {
      const auto& text = uri->get_ref<const std::string&>();
      const auto [file, fresh] = files.try_emplace(text);
      if (fresh) file->second = load_uri(text, path, cat(where, ".uri"));
      bytes = file->second;
    } else {
      if (i != 0 || !container.has_binary) fail(where, ": 'uri' is missing");
      bytes = container.binary;
    }
    if (length > bytes.size()) fail(where, ".byteLength: it says ", length, " bytes, there are ", bytes.size());
    buffers.emplace_back(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(length));
    buffer["uri"] = cat(kBuffer, i);
  }
  return buffers;
}

// Pictures are opened when they are asked for: tinygltf sees names that no callback knows, and lets them stand.
std::vector<std::string> take_images(Json& root) {
  std::vector<std::string> uris;
  Json* list = member(root, "images");
  for (size_t i = 0; list && i < list->size(); ++i) {
    Json* uri = member((*list)[i], "uri");
    uris.push_back(uri ? uri->get<std::string>() : std::string());
    if (uri) *uri = cat("image-", i);
  }
  return uris;
}

std::optional<size_t> buffer_named(const std::string& name, const std::vector<Bytes>& buffers) {
  size_t index = 0;
  if (!name.starts_with(kBuffer)) return std::nullopt;
  const auto [end, error] = std::from_chars(name.data() + kBuffer.size(), name.data() + name.size(), index);
  if (error != std::errc() || end != name.data() + name.size() || index >= buffers.size()) return std::nullopt;
  return index;
}

tinygltf::FsCallbacks callbacks_for(std::vector<Bytes>& buffers) {
  tinygltf::FsCallbacks callbacks = {};
  callbacks.user_data = &buffers;
  callbacks.FileExists = [](const std::string& name, void* data) {
    return buffer_named(name, *static_cast<std::vector<Bytes>*>(data)).has_value();
  };
  callbacks.ExpandFilePath = [](const std::string& name, void*) { return name; };
  callbacks.ReadWholeFile = [](std::vector<unsigned char>* out, std::string*, const std::string& name, void* data) {
    auto& all = *static_cast<std::vector<Bytes>*>(data);
    const auto index = buffer_named(name, all);
    if (index) *out = std::move(all[*index]);
    return index.has_value();
  };
  callbacks.WriteWholeFile = [](std::string*, const std::string&, const std::vector<unsigned char>&, void*) {
    return false;
  };
  return callbacks;
}

// How many objects of each kind there are. The check is there so that tinygltf drops none; this holds it to that.
struct Counts {
  std::vector<std::pair<std::string, size_t>> lists;
  std::vector<size_t> primitives;  // of each mesh
};

Counts count_of(const Json& root) {
  Counts counts;
  for (const auto& [key, value] : root.items()) {
    if (value.is_array()) counts.lists.emplace_back(key, value.size());
  }
  if (root.contains("meshes")) {
    for (const Json& mesh : root["meshes"]) counts.primitives.push_back(mesh["primitives"].size());
  }
  return counts;
}

void check_nothing_dropped(const Counts& counts, const tinygltf::Model& model) {
  const std::pair<std::string_view, size_t> found[] = {
      {"accessors", model.accessors.size()}, {"animations", model.animations.size()},
      {"buffers", model.buffers.size()},     {"bufferViews", model.bufferViews.size()},
      {"cameras", model.cameras.size()},     {"images", model.images.size()},
      {"materials", model.materials.size()}, {"meshes", model.meshes.size()},
      {"nodes", model.nodes.size()},         {"samplers", model.samplers.size()},
      {"scenes", model.scenes.size()},       {"skins", model.skins.size()},
      {"textures", model.textures.size()}};
  for (const auto& [key, expected] : counts.lists) {
    for (const auto& [name, count] : found) {
      if (name == key && count != expected) fail(key, ": tinygltf reads ", count, " of ", expected);
    }
  }
  for (size_t i = 0; i < counts.primitives.size(); ++i) {
    if (model.meshes[i].primitives.size() != counts.primitives[i]) fail("meshes[", i, "]: tinygltf drops a primitive");
  }
}

}  // namespace

Document load_document(std::span<const uint8_t> content, const std::string& path) {
  const Container container = open_container(content);
  Json root = parse_json(container.json);
  check_document(root);
  Document document;
  document.path = path;
  std::vector<Bytes> buffers = take_buffers(root, container, path);
  for (const Bytes& buffer : buffers) document.buffer_bytes += buffer.size();
  document.image_uris = take_images(root);

  tinygltf::TinyGLTF reader;
  reader.SetFsCallbacks(callbacks_for(buffers));
  reader.SetImageLoader([](tinygltf::Image*, int, std::string*, std::string*, int, int, const unsigned char*, int,
                           void*) { return true; },
                        nullptr);
  std::string text = root.dump();
  const Counts counts = count_of(root);
  root = nullptr;  // tinygltf makes its own
  std::string error;
  std::string warning;
  if (!reader.LoadASCIIFromString(&document.model, &error, &warning, text.data(), static_cast<unsigned>(text.size()),
                                  "")) {
    const std::string_view reason = std::string_view(error).substr(0, error.find('\n'));
    fail("tinygltf does not read it: ", in_quotes(reason, 200));
  }
  check_nothing_dropped(counts, document.model);
  return document;
}

Bytes image_file(const Document& document, size_t index) {
  const std::string where = cat("images[", index, "]");
  const tinygltf::Image& image = document.model.images[index];
  if (image.bufferView < 0) return load_uri(document.image_uris[index], document.path, where + ".uri");
  const tinygltf::BufferView& view = document.model.bufferViews[static_cast<size_t>(image.bufferView)];
  const std::vector<unsigned char>& bytes = document.model.buffers[static_cast<size_t>(view.buffer)].data;
  const auto begin = bytes.begin() + static_cast<std::ptrdiff_t>(view.byteOffset);
  return {begin, begin + static_cast<std::ptrdiff_t>(view.byteLength)};
}

}  // namespace dr::io::gltf
