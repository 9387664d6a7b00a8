// SPDX-License-Identifier: Apache-2.0
// Assembled shaders on disk, found again by their source text. An entry that is damaged, of another compiler or of
// another text with the same hash is as good as none. Nothing here fails: a cache that cannot be read or written is no
// cache.
#pragma once

#include <atomic>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace dr::backend {

class ShaderCache {
 public:
  // Keeps files in that folder, which need not exist; empty: keeps nothing.
  explicit ShaderCache(std::filesystem::path folder) : folder_(std::move(folder)) {}

  // `key` is all that the words depend on, in full: entries hold it and are compared with it.
  std::optional<std::vector<uint32_t>> find(const std::string& key) const;
  // Whole or not at all, also when several processes write. May be called from several threads.
  void store(const std::string& key, const std::vector<uint32_t>& words) const;

  // Whether this object has stored something.
  bool has_stored() const { return stored_; }
  // How many entries it has found.
  size_t found() const { return found_; }
  // Removes the entries that were not stored or found for longest until the rest have at most so many bytes. Looks at
  // every file of the folder.
  void trim(std::uintmax_t most = std::uintmax_t{256} << 20) const;

  // Where the entry of a key is kept; for tests.
  std::filesystem::path file_of(const std::string& key) const;

 private:
  std::filesystem::path folder_;
  mutable std::atomic<bool> stored_ = false;
  mutable std::atomic<size_t> found_ = 0;
};

// DRC_CACHE_DIR, or `dressi` in XDG_CACHE_HOME or ~/.cache; empty where the environment names none.
std::filesystem::path default_cache_folder();

}  // namespace dr::backend
