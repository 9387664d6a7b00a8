// SPDX-License-Identifier: Apache-2.0
// File: magic, length of the key, checksum of all that follows, key, data.
#include "runtime/pipeline_file.h"

#include <unistd.h>

#include <cstring>
#include <fstream>
#include <iterator>

namespace dr::runtime {

namespace fs = std::filesystem;

namespace {

struct Header {
  uint64_t magic = 0x3143505244524400;  // "\0DRDRPC1"
  uint64_t key_bytes = 0;
  uint64_t checksum = 0;
};

}  // namespace

uint64_t hash_bytes(const void* data, size_t bytes, uint64_t seed) {
  const auto* p = static_cast<const unsigned char*>(data);
  for (size_t k = 0; k < bytes; ++k) seed = (seed ^ p[k]) * 0x100000001b3;
  return seed;
}

PipelineFile::PipelineFile(const fs::path& folder, std::string key) : key_(std::move(key)) {
  if (folder.empty()) return;
  char name[40];
  std::snprintf(name, sizeof name, "%016llx.pipelines",
                static_cast<unsigned long long>(hash_bytes(key_.data(), key_.size())));
  path_ = folder / name;
}

std::vector<uint8_t> PipelineFile::read() const {
  if (path_.empty()) return {};
  std::ifstream file(path_, std::ios::binary);
  if (!file) return {};
  const std::string bytes(std::istreambuf_iterator<char>(file), {});
  Header header;
  if (bytes.size() < sizeof header) return {};
  std::memcpy(&header, bytes.data(), sizeof header);
  const size_t rest = bytes.size() - sizeof header;
  if (header.magic != Header{}.magic || header.key_bytes != key_.size() || rest < key_.size() ||
      header.checksum != hash_bytes(bytes.data() + sizeof header, rest) ||
      bytes.compare(sizeof header, key_.size(), key_) != 0)
    return {};
  return {bytes.begin() + static_cast<long>(sizeof header + key_.size()), bytes.end()};
}

void PipelineFile::write(std::span<const uint8_t> data) const {
  if (path_.empty()) return;
  std::error_code error;
  fs::create_directories(path_.parent_path(), error);
  if (error) return;
  std::string bytes = key_;
  bytes.append(data.begin(), data.end());
  const Header header{.key_bytes = key_.size(), .checksum = hash_bytes(bytes.data(), bytes.size())};
  const fs::path temporary = path_.string() + "." + std::to_string(getpid());
  std::ofstream out(temporary, std::ios::binary);
  out.write(reinterpret_cast<const char*>(&header), sizeof header);
  out.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  out.close();
  if (out) fs::rename(temporary, path_, error);
  if (!out || error) fs::remove(temporary, error);
}

}  // namespace dr::runtime
