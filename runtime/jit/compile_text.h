// SPDX-License-Identifier: Apache-2.0
// Compiling text that is no file, for a profile that is none. Private to runtime/jit.
#pragma once

#include "compiler/target/profile.h"
#include "runtime/jit/jit.h"

namespace dr::jit {

// As compile_file(); `name` stands for the file in messages, and the options' own profile for nothing.
io::Result<std::vector<uint8_t>> compile_text(const std::string& name, const std::string& text,
                                              const target::Profile& profile, const Options& options,
                                              Told* told = nullptr);

}  // namespace dr::jit
