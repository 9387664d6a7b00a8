// SPDX-License-Identifier: Apache-2.0
// Lines, line strips and line loops of a glTF file. Private to compiler/io; throws Failure.
#pragma once

#include "compiler/io/mesh/gltf/document.h"
#include "compiler/io/mesh/strands.h"

namespace dr::io::gltf {

// Placed by the nodes of the default scene. Colours are white where only other primitives have some.
Strands read_lines(const Document& document);

}  // namespace dr::io::gltf
