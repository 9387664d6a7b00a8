// SPDX-License-Identifier: Apache-2.0
// `drc fmt`: files in their canonical layout, on stdout, in place, or only compared.
#include <cstdio>

#include "compiler/drc/command.h"
#include "compiler/drc/input.h"
#include "compiler/drc/output.h"
#include "compiler/ir/graph.h"
#include "dsl/format/format.h"
#include "dsl/syntax/parser.h"

namespace dr::drc {
namespace {

// With the edition's line above the first declaration, where there is none.
std::string with_edition(const std::string& file, const std::string& text) {
  dsl::SourceManager sources;
  dsl::DiagnosticList diagnostics;
  dsl::parse(sources, sources.add(shown_name(file), text), diagnostics);
  for (const dsl::Diagnostic& found : diagnostics.all())
    if (found.code == dsl::Code::E0108)
      return std::string(text).insert(found.span.begin, "edition " + std::to_string(dsl::kEdition) + ";\n\n");
  return text;
}

bool format_file(const std::string& file, const FormatOptions& options, bool& would_change) {
  const auto text = read_text(file);
  if (!text) return false;
  dsl::SourceManager sources;
  dsl::DiagnosticList diagnostics;
  const dsl::FileId id = sources.add(shown_name(file), options.edition ? with_edition(file, *text) : *text);
  const dsl::FormatResult result = dsl::format_source(sources, id, diagnostics);
  report(diagnostics, sources);
  if (result.has_errors) return false;
  if (!result.internal_error.empty()) DR_ICE(shown_name(file) + ": " + result.internal_error);
  if (options.check) {
    if (result.text == *text) return true;
    would_change = true;
    std::printf("%s\n", shown_name(file).c_str());
    return true;
  }
  if (!options.in_place) return write_product("-", result.text);
  return result.text == *text || write_product(file, result.text);
}

}  // namespace

int fmt(const FormatOptions& options) {
  bool good = true;
  bool would_change = false;
  for (const std::string& file : options.files) good = format_file(file, options, would_change) && good;
  return good && !would_change ? kOk : kUserError;
}

}  // namespace dr::drc
