// SPDX-License-Identifier: Apache-2.0
// GLSL -> SPIR-V by glslang, made strict and validated.
#pragma once

#include <cstdint>
#include <string>
#include <variant>
#include <vector>

#include "compiler/backend/compile.h"

namespace dr::backend {

// SPIR-V 1.3 for Vulkan 1.1, or what glslang or the validator says. Every float arithmetic instruction is decorated
// NoContraction: a fused multiply-add would give another answer on another device or in another pass.
std::variant<std::vector<uint32_t>, std::string> assemble(const GlslShader& shader);

// Adds the NoContraction decorations a module lacks; exposed for tests.
std::vector<uint32_t> decorate_no_contraction(const std::vector<uint32_t>& module);

}  // namespace dr::backend
