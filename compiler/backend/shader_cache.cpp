// SPDX-License-Identifier: Apache-2.0
// Entry: magic, length of the key, number of words, checksum of both, key, words.
#include "compiler/backend/shader_cache.h"

#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>

namespace dr::backend {

namespace fs = std::filesystem;

namespace {

constexpr uint64_t kMagic = 0x3143485344524400;  // "\0DRDSHC1"

struct Header {
  uint64_t magic = kMagic;
  uint64_t key_bytes = 0;
  uint64_t words = 0;
  uint64_t checksum = 0;
};

// FNV-1a, 64 bits.
uint64_t hash(const void* data, size_t bytes, uint64_t seed = 0xcbf29ce484222325) {
  const auto* p = static_cast<const unsigned char*>(data);
  for (size_t k = 0; k < bytes; ++k) seed = (seed ^ p[k]) * 0x100000001b3;
  return seed;
}

uint64_t checksum(const std::string& key, const std::vector<uint32_t>& words) {
  return hash(words.data(), words.size() * sizeof(uint32_t), hash(key.data(), key.size()));
}

}  // namespace

fs::path ShaderCache::file_of(const std::string& key) const {
  char name[32];
  std::snprintf(name, sizeof name, "%016llx.spv", static_cast<unsigned long long>(hash(key.data(), key.size())));
  return folder_ / name;
}

std::optional<std::vector<uint32_t>> ShaderCache::find(const std::string& key) const {
  if (folder_.empty()) return std::nullopt;
  std::ifstream file(file_of(key), std::ios::binary);
  if (!file) return std::nullopt;
  const std::string bytes(std::istreambuf_iterator<char>(file), {});
  Header header;
  if (bytes.size() < sizeof header) return std::nullopt;
  std::memcpy(&header, bytes.data(), sizeof header);
  const size_t rest = bytes.size() - sizeof header;
  if (header.magic != kMagic || header.key_bytes != key.size() || rest < key.size() ||
      (rest - key.size()) % sizeof(uint32_t) != 0 || header.words != (rest - key.size()) / sizeof(uint32_t) ||
      bytes.compare(sizeof header, key.size(), key) != 0)
    return std::nullopt;
  std::vector<uint32_t> words(static_cast<size_t>(header.words));
  std::memcpy(words.data(), bytes.data() + sizeof header + key.size(), words.size() * sizeof(uint32_t));
  if (checksum(key, words) != header.checksum) return std::nullopt;
  std::error_code ignored;
  fs::last_write_time(file_of(key), fs::file_time_type::clock::now(), ignored);
  return words;
}

void ShaderCache::store(const std::string& key, const std::vector<uint32_t>& words) const {
  if (folder_.empty()) return;
  std::error_code error;
  fs::create_directories(folder_, error);
  if (error) return;
  static std::atomic<unsigned> counter{0};
  const fs::path file = file_of(key);
  const fs::path temporary = file.string() + "." + std::to_string(getpid()) + "." + std::to_string(counter++);
  const Header header{kMagic, key.size(), words.size(), checksum(key, words)};
  std::ofstream out(temporary, std::ios::binary);
  out.write(reinterpret_cast<const char*>(&header), sizeof header);
  out.write(key.data(), static_cast<std::streamsize>(key.size()));
  out.write(reinterpret_cast<const char*>(words.data()), static_cast<std::streamsize>(words.size() * sizeof(uint32_t)));
  out.close();
  if (out) fs::rename(temporary, file, error);
  if (!out || error)
    fs::remove(temporary, error);
  else
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
