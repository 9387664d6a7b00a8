// SPDX-License-Identifier: Apache-2.0
// The float profile `native`: what GLSL itself has for an op instead of our own function.
#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "compiler/ops/op.h"

namespace dr::ops {

// A text of the strict prelude -> the text that stands for it: the same functions, made of built-ins; those without a
// built-in are given back as they are, and call the others. Where the strict function is finite, so is this one: what a
// built-in leaves undefined, or computes by way of something that overflows, is kept from it.
std::string_view native_prelude(std::string_view strict);

// The expression of an op whose strict one calls no function of the prelude; nothing: the strict one stands.
std::optional<std::string> native_glsl(ir::OpKind kind, const GlslInput& input);

}  // namespace dr::ops
