// SPDX-License-Identifier: Apache-2.0
// The shaders of a bundle: what they may bind, and their SPIR-V.
#pragma once

#include <filesystem>
#include <optional>

#include "compiler/backend/compile.h"

namespace dr::backend {

// What a raster or scatter shader binds depends on the program alone: the first command that binds more than the
// profile allows is a limit met.
std::optional<Limit> bindings_over_limit(const bundle::BundleT& bundle, const target::Profile& profile);

// Words are counted by an int in shaders: the first resource that has too many, however small symbols are.
std::optional<Limit> words_over_limit(const bundle::BundleT& bundle);

// Assembles the GLSL of `compiled` on all cores, and gives its bundle the modules and the features that they need. The
// bytes do not depend on the number of cores.
void assemble_shaders(const std::filesystem::path& cache_folder, Compiled& compiled);

}  // namespace dr::backend
