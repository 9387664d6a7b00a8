// SPDX-License-Identifier: Apache-2.0
// Diagnostics and places as the protocol writes them.
#include <algorithm>

#include "compiler/language_server/answers.h"
#include "compiler/language_server/library_files.h"

namespace dr::language_server {
namespace {

Json place_json(Place place) { return {{"line", place.line}, {"character", place.character}}; }

// A message about another file stands where the root file leads there.
dsl::Span place_in_root(const Analysis& analysis, const dsl::Diagnostic& diagnostic) {
  if (diagnostic.span.valid() && diagnostic.span.file == analysis.root()) return diagnostic.span;
  for (const dsl::Note& note : diagnostic.notes)
    if (note.span.valid() && note.span.file == analysis.root()) return note.span;
  return {analysis.root(), 0, 0};
}

Json diagnostic_json(const Analysis& analysis, const dsl::Diagnostic& diagnostic,
                     const std::filesystem::path& library) {
  const dsl::Span span = place_in_root(analysis, diagnostic);
  std::string message = diagnostic.message;
  Json related = Json::array();
  const auto add_related = [&](const dsl::Span& place, const std::string& text) {
    const Json location = location_json(analysis, place, library);
    if (!location.is_null()) related.push_back({{"location", location}, {"message", text}});
  };
  if (diagnostic.span.valid() && diagnostic.span.file != analysis.root()) add_related(diagnostic.span, message);
  for (const dsl::Note& note : diagnostic.notes) {
    if (!note.span.valid()) {
      message += "\nnote: " + note.message;
    } else {
      add_related(note.span, note.message);
    }
  }
  if (!diagnostic.help.empty()) message += "\nhelp: " + diagnostic.help;
  Json json = {{"range", range_json(analysis.lines(), span.begin, span.end)},
               {"severity", diagnostic.severity == dsl::Severity::Error ? 1 : 2},
               {"code", dsl::code_name(diagnostic.code)},
               {"source", "drc"},
               {"message", message}};
  if (!related.empty()) json["relatedInformation"] = std::move(related);
  return json;
}

}  // namespace

Json range_json(const Lines& lines, uint32_t begin, uint32_t end) {
  return {{"start", place_json(lines.place(begin))}, {"end", place_json(lines.place(end))}};
}

Json location_json(const Analysis& analysis, const dsl::Span& span, const std::filesystem::path& library) {
  if (!span.valid()) return nullptr;
  const auto place = analysis.place_of(span.file);
  if (!place) return nullptr;
  std::string path(analysis.sources().name(span.file));
  const bool is_root = span.file == analysis.root();
  if (analysis.observation().files[*place].is_library) {
    const auto file = library_file(library, path);
    if (!file) return nullptr;
    path = *file;
  }
  const Lines lines(analysis.sources().text(span.file));
  return {{"uri", is_root ? analysis.uri() : uri_of_path(path)}, {"range", range_json(lines, span.begin, span.end)}};
}

Json diagnostics(const Analysis& analysis, const std::filesystem::path& library) {
  Json all = Json::array();
  const std::vector<dsl::Diagnostic>& found = analysis.diagnostics().all();
  for (size_t i = 0; i < std::min(found.size(), analysis.shown_diagnostics()); ++i)
    all.push_back(diagnostic_json(analysis, found[i], library));
  if (!analysis.internal_error().empty()) {
    all.push_back({{"range", range_json(analysis.lines(), 0, 0)},
                   {"severity", 1},
                   {"source", "drc"},
                   {"message", "internal error: " + analysis.internal_error()}});
  }
  return all;
}

}  // namespace dr::language_server
