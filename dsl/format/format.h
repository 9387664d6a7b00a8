// SPDX-License-Identifier: Apache-2.0
// The canonical layout of a `.dr` file. Tokens and comments stay as they are and in their order, so the meaning does
// too; spaces, indentation and line breaks are made anew. What a person chose is kept where both choices read well:
// single blank lines, a short block on one line or on several, and the line breaks of a list that needs several lines.
#pragma once

#include <string>

#include "dsl/diagnostic/diagnostic.h"
#include "dsl/source/source.h"

namespace dr::dsl {

inline constexpr size_t kFormatWidth = 120;  // columns of a line, exceeded only where nothing can be broken

struct FormatResult {
  std::string text;            // the file anew, if there is neither of the others
  bool has_errors = false;     // the file does not parse: see the diagnostics
  std::string internal_error;  // the layout would have changed the program: a mistake of the formatter
};

// Formats a file of `sources`, and checks that the syntax tree and the comments of the result are those of the file.
FormatResult format_source(const SourceManager& sources, FileId file, DiagnosticList& diagnostics);

}  // namespace dr::dsl
