// SPDX-License-Identifier: Apache-2.0
// File: magic, length of the key, checksum of all that follows, key, data.
#include "runtime/cache/pipeline_file.h"

#include <cstring>

#include "compiler/backend/bundle/bundle.h"
#include "compiler/backend/bundle/own_file.h"

namespace dr::runtime {

namespace fs = std::filesystem;

namespace {

struct Header {
  uint64_t magic = 0x3243505244524400;  // "\0DRDRPC2"
  uint64_t key_bytes = 0;
  uint64_t checksum = 0;
};

}  // namespace

PipelineFile::PipelineFile(const fs::path& folder, std::string key) : key_(std::move(key)) {
  if (folder.empty()) return;
  char name[40];
  std::snprintf(name, sizeof name, "%016llx.pipelines",
                static_cast<unsigned long long>(bundle::checksum(key_.data(), key_.size())));
  path_ = folder / name;
}

std::vector<uint8_t> PipelineFile::read() const {
  if (path_.empty()) return {};
  const std::string bytes = bundle::read_own_file(path_).value_or("");
  Header header;
  if (bytes.size() < sizeof header) return {};
  std::memcpy(&header, bytes.data(), sizeof header);
  const size_t rest = bytes.size() - sizeof header;
  if (header.magic != Header{}.magic || header.key_bytes != key_.size() || rest < key_.size() ||
      header.checksum != bundle::checksum(bytes.data() + sizeof header, rest) ||
      bytes.compare(sizeof header, key_.size(), key_) != 0)
    return {};
  return {bytes.begin() + static_cast<long>(sizeof header + key_.size()), bytes.end()};
}

void PipelineFile::write(std::span<const uint8_t> data) const {
  if (path_.empty()) return;
  std::string bytes = key_;
  bytes.append(data.begin(), data.end());
  const Header header{.key_bytes = key_.size(), .checksum = bundle::checksum(bytes.data(), bytes.size())};
  bundle::write_own_file(path_, {{reinterpret_cast<const char*>(&header), sizeof header}, bytes});
}

}  // namespace dr::runtime
