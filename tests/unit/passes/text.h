// SPDX-License-Identifier: Apache-2.0
// Graphs from text, for tests of passes.
#pragma once

#include <string>
#include <string_view>

#include "compiler/ir/parse.h"
#include "compiler/ir/print.h"
#include "tests/catch.h"

namespace dr::passes_test {

inline ir::Graph read(std::string_view text) {
  auto parsed = ir::parse(text);
  if (const auto* error = std::get_if<ir::ParseError>(&parsed))
    FAIL("line " << error->line << ": " << error->message << "\n" << text);
  return std::get<ir::Graph>(std::move(parsed));
}

}  // namespace dr::passes_test
