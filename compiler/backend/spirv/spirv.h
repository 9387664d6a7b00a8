// SPDX-License-Identifier: Apache-2.0
// GLSL -> SPIR-V by glslang, made strict, optimized and validated.
#pragma once

#include <cstdint>
#include <string>
#include <variant>
#include <vector>

#include "compiler/backend/glsl/source.h"
#include "compiler/backend/spirv/shader_cache.h"

namespace dr::backend {

// SPIR-V 1.3 for Vulkan 1.1, or what glslang or the validator says. Every float arithmetic instruction is decorated
// NoContraction: a fused multiply-add would give another answer on another device or in another pass. Of a `native`
// shader only those of functions other than main are: our own functions, which stand for no built-in, count on their
// roundings. A sound module is kept in the cache and taken from it.
std::variant<std::vector<uint32_t>, std::string> assemble(const GlslShader& shader, const ShaderCache& cache);

// The module as text with friendly names, as spirv-dis writes it.
std::string disassemble(const std::vector<uint32_t>& module);

// Adds the NoContraction decorations a module lacks, or those that its functions other than the entry point lack;
// exposed for tests.
std::vector<uint32_t> decorate_no_contraction(const std::vector<uint32_t>& module, bool but_main = false);

}  // namespace dr::backend
