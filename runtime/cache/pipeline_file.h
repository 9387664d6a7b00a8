// SPDX-License-Identifier: Apache-2.0
// What a driver wants kept of its pipelines, as a file. A file that is damaged, or of another key, is as good as none:
// no driver sees it. Nothing here fails. No Vulkan.
#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

namespace dr::runtime {

class PipelineFile {
 public:
  // `key` is all that the pipelines depend on: device, driver, shaders, sizes. An empty folder keeps nothing.
  PipelineFile(const std::filesystem::path& folder, std::string key);
  // Empty: there is none.
  std::vector<uint8_t> read() const;
  // Whole or not at all. Makes the folder.
  void write(std::span<const uint8_t> data) const;
  const std::filesystem::path& path() const { return path_; }

 private:
  std::string key_;
  std::filesystem::path path_;
};

}  // namespace dr::runtime
