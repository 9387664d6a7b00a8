// SPDX-License-Identifier: Apache-2.0
// The documentation of a module as Markdown: what it declares, as written, with the `///` text of each.
#pragma once

#include <string>

#include "dsl/source/source.h"
#include "dsl/syntax/ast.h"

namespace dr::dsl {

// `module` was parsed from a file of `sources` without errors; `name` is the title.
std::string document(const Module& module, const SourceManager& sources, const std::string& name);

}  // namespace dr::dsl
