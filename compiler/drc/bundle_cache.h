// SPDX-License-Identifier: Apache-2.0
// Whole bundles on disk, beside the shaders (compiler/backend/spirv/shader_cache.h): the same program for the same
// profile by the same drc is compiled once.
#pragma once

#include <optional>
#include <string>

#include "compiler/drc/command.h"
#include "dsl/source/source.h"

namespace dr::drc {

class BundleCache {
 public:
  // Of `drc build` with these options. Keeps nothing where they ask for more than a bundle, or for no cache; where
  // imports may come from files (-I, a folder `std` beside the program); where this drc has no build id.
  explicit BundleCache(const BuildOptions& options);

  std::optional<std::string> find() const;
  // `sources` are the files that the bundle was made of: it is kept if they are the program and the library's modules.
  void store(const std::string& bundle, const dsl::SourceManager& sources) const;

 private:
  std::string key_;  // empty: keeps nothing
};

}  // namespace dr::drc
