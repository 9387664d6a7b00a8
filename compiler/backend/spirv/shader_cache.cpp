// SPDX-License-Identifier: Apache-2.0
// Entry: magic, length of the key, number of words, checksum of the words, key, words.
#include "compiler/backend/spirv/shader_cache.h"

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <span>
#include <string_view>

#include "compiler/backend/bundle/bundle.h"
#include "compiler/backend/bundle/own_file.h"

namespace dr::backend {

namespace fs = std::filesystem;

namespace {

constexpr uint64_t kMagic = 0x3243485344524400;  // "\0DRDSHC2"

struct Header {
  uint64_t magic = kMagic;
  uint64_t key_bytes = 0;
  uint64_t words = 0;
  uint64_t checksum = 0;
};

uint64_t checksum(std::span<const uint32_t> words) { return bundle::checksum(words.data(), words.size_bytes()); }

}  // namespace

fs::path ShaderCache::file_of(const std::string& key) const {
  char name[32];
  std::snprintf(name, sizeof name, "%016llx.spv",
                static_cast<unsigned long long>(bundle::checksum(key.data(), key.size())));
  return folder_ / name;
}

std::optional<std::vector<uint32_t>> ShaderCache::find(const std::string& key) const {
  if (folder_.empty()) return std::nullopt;
  const auto entry = bundle::read_own_file(file_of(key));
  Header header;
  if (!entry || entry->size() < sizeof header + key.size()) return std::nullopt;
  std::memcpy(&header, entry->data(), sizeof header);
  const size_t bytes = entry->size() - sizeof header - key.size();
  if (header.magic != kMagic || header.key_bytes != key.size() || header.words != bytes / sizeof(uint32_t) ||
      bytes % sizeof(uint32_t) != 0 || entry->compare(sizeof header, key.size(), key) != 0)
    return std::nullopt;
  std::vector<uint32_t> words(static_cast<size_t>(header.words));
  std::memcpy(words.data(), entry->data() + sizeof header + key.size(), bytes);
  if (checksum(words) != header.checksum) return std::nullopt;
  ++found_;
  return words;
}

void ShaderCache::store(const std::string& key, const std::vector<uint32_t>& words) const {
  if (folder_.empty()) return;
  const Header header{kMagic, key.size(), words.size(), checksum(words)};
  const auto bytes = [](const void* data, size_t size) {
    return std::string_view(static_cast<const char*>(data), size);
  };
  if (bundle::write_own_file(
          file_of(key), {bytes(&header, sizeof header), key, bytes(words.data(), words.size() * sizeof(uint32_t))}))
    stored_ = true;
}

void ShaderCache::trim(std::uintmax_t most) const {
  struct Entry {
    fs::file_time_type used;
    fs::path file;
    std::uintmax_t bytes;
  };
  std::vector<Entry> entries;
  std::uintmax_t total = 0;
  std::error_code error;
  for (fs::directory_iterator at(folder_, error), end; !error && at != end; at.increment(error)) {
    std::error_code unreadable;
    Entry entry{at->last_write_time(unreadable), at->path(), 0};
    if (unreadable || entry.file.extension() != ".spv") continue;
    entry.bytes = at->file_size(unreadable);
    if (unreadable) continue;
    total += entry.bytes;
    entries.push_back(std::move(entry));
  }
  if (total <= most) return;
  std::ranges::sort(entries, {}, &Entry::used);
  for (const Entry& entry : entries) {
    if (total <= most) return;
    if (fs::remove(entry.file, error)) total -= entry.bytes;
  }
}

fs::path default_cache_folder() {
  auto variable = [](const char* name) -> std::string {
    const char* value = std::getenv(name);
    return value == nullptr ? "" : value;
  };
  if (const std::string own = variable("DRC_CACHE_DIR"); !own.empty()) return own;
  // A relative XDG folder is to be ignored, says its specification.
  if (const fs::path xdg = variable("XDG_CACHE_HOME"); xdg.is_absolute()) return xdg / "dressi";
  if (const fs::path home = variable("HOME"); home.is_absolute()) return home / ".cache" / "dressi";
  return {};
}

}  // namespace dr::backend
