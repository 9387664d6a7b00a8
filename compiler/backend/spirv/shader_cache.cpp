// SPDX-License-Identifier: Apache-2.0
// Entry: magic, length of the key, number of words, checksum of the words, key, words.
#include "compiler/backend/spirv/shader_cache.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <span>

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

// FNV-1a over words of 64 bits, the last one filled up with zeros. A product carries a word's bits upwards only, so the
// upper half is folded back onto the lower one.
uint64_t hash(const void* data, size_t bytes) {
  const auto* p = static_cast<const unsigned char*>(data);
  uint64_t state = 0xcbf29ce484222325 ^ bytes;
  for (size_t k = 0; k < bytes; k += sizeof(uint64_t)) {
    uint64_t word = 0;
    std::memcpy(&word, p + k, std::min(sizeof word, bytes - k));
    state = (state ^ word) * 0x100000001b3;
    state ^= state >> 32;
  }
  return state;
}

uint64_t checksum(std::span<const uint32_t> words) { return hash(words.data(), words.size_bytes()); }

// A file that is open for reading; -1: there is none.
struct File {
  explicit File(const char* name) : descriptor(open(name, O_RDONLY | O_CLOEXEC)) {}
  File(const File&) = delete;
  File& operator=(const File&) = delete;
  ~File() {
    if (descriptor >= 0) close(descriptor);
  }
  int descriptor;
};

// So many bytes, fewer only at the end of the file or after an error.
bool read_all(int descriptor, void* to, size_t bytes) {
  auto* at = static_cast<char*>(to);
  while (bytes > 0) {
    const ssize_t n = read(descriptor, at, bytes);
    if (n <= 0) return false;
    at += n;
    bytes -= static_cast<size_t>(n);
  }
  return true;
}

}  // namespace

fs::path ShaderCache::file_of(const std::string& key) const {
  char name[32];
  std::snprintf(name, sizeof name, "%016llx.spv", static_cast<unsigned long long>(hash(key.data(), key.size())));
  return folder_ / name;
}

std::optional<std::vector<uint32_t>> ShaderCache::find(const std::string& key) const {
  if (folder_.empty()) return std::nullopt;
  const File file(file_of(key).c_str());
  if (file.descriptor < 0) return std::nullopt;
  struct stat status = {};
  Header header;
  if (fstat(file.descriptor, &status) != 0 || !read_all(file.descriptor, &header, sizeof header)) return std::nullopt;
  const auto size = static_cast<uint64_t>(status.st_size);
  if (header.magic != kMagic || header.key_bytes != key.size() || size < sizeof header + key.size() ||
      header.words != (size - sizeof header - key.size()) / sizeof(uint32_t) ||
      size != sizeof header + key.size() + header.words * sizeof(uint32_t))
    return std::nullopt;
  std::string stored_key(key.size(), '\0');
  std::vector<uint32_t> words(static_cast<size_t>(header.words));
  if (!read_all(file.descriptor, stored_key.data(), stored_key.size()) || stored_key != key ||
      !read_all(file.descriptor, words.data(), words.size() * sizeof(uint32_t)) || checksum(words) != header.checksum)
    return std::nullopt;
  futimens(file.descriptor, nullptr);  // used now; no matter if that cannot be noted
  ++found_;
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
  const Header header{kMagic, key.size(), words.size(), checksum(words)};
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
