// SPDX-License-Identifier: Apache-2.0
// Whether inputs that index other leaves, such as the faces of a mesh, name elements that are there.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <span>
#include <string>

#include "compiler/io/array/array.h"

namespace dr::jit {

// Looks at reads `a.at(face.x)` that these steps make whose column `face.x` is that of an input among `data`, arrays by
// leaf: which leaf, column and element name something beyond `a`, in a sentence, or nothing. -1 names nothing and is
// fine. Arrays of floats may lack their bytes. `symbols` has the values of symbols that no data gives; reads of what
// has no size by then are left out.
std::optional<std::string> check_indices(std::span<const uint8_t> bundle, std::span<const std::string> steps,
                                         const std::map<std::string, io::Array>& data,
                                         std::map<std::string, int64_t> symbols);

}  // namespace dr::jit
