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

// Where the `///` lines right above a place begin: they are about what stands there.
size_t begin_of_doc(std::string_view text, size_t place) {
  size_t begin = place == 0 ? 0 : text.rfind('\n', place - 1) + 1;
  while (begin > 0) {
    const size_t above = begin < 2 ? 0 : text.rfind('\n', begin - 2) + 1;
    const std::string_view line = text.substr(above, begin - above);
    if (!line.substr(std::min(line.find_first_not_of(" \t"), line.size())).starts_with("///")) break;
    place = begin = above;
  }
  return place;
}

// With the edition's line above the first declaration, where there is none.
std::string with_edition(const std::string& file, const std::string& text) {
  dsl::SourceManager sources;
  dsl::DiagnosticList diagnostics;
  dsl::parse(sources, sources.add(shown_name(file), text), diagnostics);
  for (const dsl::Diagnostic& found : diagnostics.all())
    if (found.code == dsl::Code::E0108)
      return std::string(text).insert(begin_of_doc(text, found.span.begin),
                                      "edition " + std::to_string(dsl::kEdition) + ";\n\n");
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
  return result.text == *text || rewrite_file(file, *text, result.text);
}

}  // namespace

int fmt(const FormatOptions& options) {
  bool good = true;
  bool would_change = false;
  for (const std::string& file : options.files) good = format_file(file, options, would_change) && good;
  return good && !would_change ? kOk : kUserError;
}

}  // namespace dr::drc
