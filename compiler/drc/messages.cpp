// SPDX-License-Identifier: Apache-2.0
// Messages as text or as JSON.
#include "compiler/drc/messages.h"

#include <cstdio>
#include <nlohmann/json.hpp>
#include <optional>

namespace dr::drc {
namespace {

using Json = nlohmann::ordered_json;

std::optional<Json>& collected() {
  static std::optional<Json> messages;
  return messages;
}

Json message_json(std::string_view severity, const std::string& message) {
  return {{"severity", severity}, {"code", nullptr},        {"message", message}, {"file", nullptr},
          {"range", nullptr},     {"notes", Json::array()}, {"help", nullptr}};
}

// Lines and columns count from 1, columns and offsets in bytes; the end is behind the last byte.
void add_place(Json& json, const dsl::Span& span, const dsl::SourceManager& sources) {
  if (!span.valid()) return;
  const dsl::Position begin = sources.position(span.file, span.begin);
  const dsl::Position end = sources.position(span.file, span.end);
  json["file"] = sources.name(span.file);
  json["range"] = {{"line", begin.line},       {"column", begin.column}, {"end_line", end.line},
                   {"end_column", end.column}, {"offset", span.begin},   {"end_offset", span.end}};
}

Json diagnostic_json(const dsl::Diagnostic& diagnostic, const dsl::SourceManager& sources) {
  Json json = message_json(diagnostic.severity == dsl::Severity::Error ? "error" : "warning", diagnostic.message);
  json["code"] = dsl::code_name(diagnostic.code);
  add_place(json, diagnostic.span, sources);
  for (const dsl::Note& note : diagnostic.notes) {
    Json note_json = {{"message", note.message}, {"file", nullptr}, {"range", nullptr}};
    add_place(note_json, note.span, sources);
    json["notes"].push_back(std::move(note_json));
  }
  if (!diagnostic.help.empty()) json["help"] = diagnostic.help;
  return json;
}

}  // namespace

void collect_messages() { collected() = Json::array(); }

void write_messages() {
  if (!collected()) return;
  // Bytes of a file's name that are not UTF-8 must not cost the whole document.
  const std::string text = collected()->dump(2, ' ', false, Json::error_handler_t::replace);
  std::fprintf(stderr, "%s\n", text.c_str());
}

void report(const dsl::DiagnosticList& diagnostics, const dsl::SourceManager& sources) {
  if (!collected()) {
    std::fputs(dsl::format(diagnostics, sources).c_str(), stderr);
    return;
  }
  for (const dsl::Diagnostic& diagnostic : diagnostics.all()) {
    collected()->push_back(diagnostic_json(diagnostic, sources));
  }
}

namespace {

void print_message(const char* severity, const std::string& message) {
  if (collected()) {
    collected()->push_back(message_json(severity, message));
  } else {
    std::fprintf(stderr, "%s: %s\n", severity, message.c_str());
  }
}

}  // namespace

void print_error(const std::string& message) { print_message("error", message); }
void print_warning(const std::string& message) { print_message("warning", message); }

void print_line_error(const dsl::SourceManager& sources, dsl::FileId file, uint32_t line, const std::string& message) {
  const std::string name(sources.name(file));
  if (!collected()) {
    std::fprintf(stderr, "%s:%u: error: %s\n", name.c_str(), line, message.c_str());
    return;
  }
  const std::string_view text = sources.line(file, line);
  const auto begin = static_cast<uint32_t>(text.data() - sources.text(file).data());
  Json json = message_json("error", message);
  add_place(json, {file, begin, begin + static_cast<uint32_t>(text.size())}, sources);
  collected()->push_back(std::move(json));
}

}  // namespace dr::drc
