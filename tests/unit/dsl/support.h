// SPDX-License-Identifier: Apache-2.0
// What the tests of the front end share: a text goes in, a tree or a list of errors comes out as text.
#pragma once

#include <string>
#include <string_view>
#include <utility>

#include "dsl/diagnostic/diagnostic.h"
#include "dsl/source/source.h"
#include "dsl/syntax/ast.h"
#include "dsl/syntax/dump.h"
#include "dsl/syntax/parser.h"

namespace dr::dsl::test {

struct Parsed {
  SourceManager sources;
  DiagnosticList diagnostics;
  Module module;

  explicit Parsed(std::string text) {
    const FileId file = sources.add("test.dr", std::move(text));
    module = parse(sources, file, diagnostics);
  }
  std::string messages() const { return format(diagnostics, sources); }
};

// The dump of the items of a file that must have no errors; else the errors. The edition is put in front.
inline std::string items(std::string_view text) {
  const Parsed parsed("edition 1; " + std::string(text));
  if (parsed.diagnostics.has_errors()) return parsed.messages();
  const std::string tree = dump(parsed.module);
  return tree.substr(tree.find('\n') + 1);
}

// A dump in one line, for tests that do not look at the layout.
inline std::string flat(std::string_view tree) {
  std::string out;
  for (size_t at = 0; at < tree.size(); ++at) {
    if (tree[at] != '\n') {
      out += tree[at];
      continue;
    }
    while (at + 1 < tree.size() && tree[at + 1] == ' ') ++at;
    if (at + 1 < tree.size()) out += ' ';
  }
  return out;
}

// The dump of one expression in one line, or the errors.
inline std::string expression(std::string_view text) {
  SourceManager sources;
  DiagnosticList diagnostics;
  const ExprPtr expr = parse_expression(sources, sources.add("test.dr", std::string(text)), diagnostics);
  return diagnostics.has_errors() ? format(diagnostics, sources) : flat(dump(*expr));
}

// One line an error: `E0101 2:7 expected ...`, with ` | help` behind it.
inline std::string errors(std::string text) {
  const Parsed parsed(std::move(text));
  std::string out;
  for (const Diagnostic& diagnostic : parsed.diagnostics.all()) {
    const Position position = parsed.sources.position(diagnostic.span.file, diagnostic.span.begin);
    out += std::string(code_name(diagnostic.code)) + ' ' + std::to_string(position.line) + ':' +
           std::to_string(position.column) + ' ' + diagnostic.message;
    if (!diagnostic.help.empty()) out += " | " + diagnostic.help;
    out += '\n';
  }
  return out;
}

// The errors of a file whose edition stands in a line of its own: line 2 is the first of `text`.
inline std::string item_errors(std::string_view text) { return errors("edition 1;\n" + std::string(text)); }

// The same for statements in the body of a function: line 3 is the first of `text`.
inline std::string body_errors(std::string_view text) {
  return item_errors("fn f() {\n" + std::string(text) + "\n}\n");
}

inline std::string repeat(std::string_view text, size_t count) {
  std::string out;
  out.reserve(text.size() * count);
  for (size_t i = 0; i < count; ++i) out += text;
  return out;
}

}  // namespace dr::dsl::test
