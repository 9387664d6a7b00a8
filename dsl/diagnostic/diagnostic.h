// SPDX-License-Identifier: Apache-2.0
// Diagnostics: one catalogue of stable codes (diagnostic_codes.def), a list that collects messages,
// and a formatter that prints them with the source line and a caret.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "dsl/source/source.h"

namespace dr::dsl {

enum class Severity : uint8_t { Error, Warning };

// One enumerator a row of diagnostic_codes.def: DR_DIAGNOSTIC(E0312, "one-line summary").
// Groups: E00xx lexer, E01xx parser, E02xx names and modules, E03xx types, E04xx extents,
// E05xx constants and control flow, E06xx leaves, steps and gradients, E07xx raster and regions.
enum class Code : uint16_t {
#define DR_DIAGNOSTIC(code, summary) code,
#include "dsl/diagnostic/diagnostic_codes.def"
#undef DR_DIAGNOSTIC
};

std::string_view code_name(Code code);     // "E0312"
std::string_view code_summary(Code code);  // the row's summary

// A second place in the code that explains the first.
struct Note {
  Span span;  // may be invalid: then only the text is printed
  std::string message;
};

// Messages are lower case, one sentence, no full stop; they say found and expected.
struct Diagnostic {
  Severity severity = Severity::Error;
  Code code{};
  Span span;
  std::string message;
  std::vector<Note> notes;
  std::string help;  // empty unless the fix is certain
};

class DiagnosticList {
 public:
  static constexpr size_t kMaxErrors = 20;  // later ones are counted, not kept
  Diagnostic& error(Code code, const Span& span, std::string message);
  Diagnostic& warning(Code code, const Span& span, std::string message);
  bool has_errors() const { return error_count_ > 0; }
  size_t error_count() const { return error_count_; }
  bool full() const { return error_count_ >= kMaxErrors; }
  const std::vector<Diagnostic>& all() const { return list_; }

 private:
  std::vector<Diagnostic> list_;
  Diagnostic overflow_;  // sink for what comes after kMaxErrors
  size_t error_count_ = 0;
};

// The form printed on stderr:
//   fit.dr:12:13: error[E0312]: cannot add vec3 and vec4
//   12 |     let x = color + offset;
//      |             ^^^^^^^^^^^^^^
//   fit.dr:7:5: note: 'offset' declared here
//   help: ...
// Lines that are very long are cut around the caret; tabs print as one space; bytes that are not
// ASCII are printed as they are and the caret line counts them as one column per code point.
std::string format(const DiagnosticList& list, const SourceManager& sources);

// The nearest of `candidates` to a misspelled `name`, if one is close enough to suggest.
std::optional<std::string> nearest_name(std::string_view name, const std::vector<std::string>& candidates);

}  // namespace dr::dsl
