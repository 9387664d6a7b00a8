// SPDX-License-Identifier: Apache-2.0
// The compiler for programs that run: full rebuilds of the reactive cache.
#pragma once

#include <cstdint>
#include <vector>

#include "runtime/jit/jit.h"
#include "runtime/runtime.h"

namespace dr::jit {

// For runtime::LoadOptions::rebuild. The bundle's own graph is compiled, with the lowering and float profile that the
// bundle has and the rest of `options`; without a profile there, the built-in one that the bundle was built for. Where
// that does not give the bundle's own shaders again, or splitting it would sum scattered values in another way, nothing
// is rebuilt: results keep their bits.
runtime::Rebuild rebuilder(std::vector<uint8_t> bundle, const Options& options = {});

}  // namespace dr::jit
