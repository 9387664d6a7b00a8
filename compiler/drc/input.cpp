// SPDX-License-Identifier: Apache-2.0
// Reading programs for the commands.
#include "compiler/drc/input.h"

#include <cstdio>
#include <iostream>
#include <sstream>

#include "compiler/io/program_text.h"
#include "dsl/diagnostic/diagnostic.h"
#include "dsl/syntax/dump.h"
#include "dsl/syntax/parser.h"

namespace dr::drc {

std::string shown_name(const std::string& file) { return file == "-" ? "<stdin>" : file; }

std::optional<std::pair<std::string, std::string>> split_assignment(const std::string& text, std::string_view option) {
  const size_t equals = text.find('=');
  if (equals == std::string::npos || equals == 0) {
    print_error("expected name=value after " + std::string(option) + ", found '" + text + "'");
    return std::nullopt;
  }
  return std::pair{text.substr(0, equals), text.substr(equals + 1)};
}

std::optional<std::string> read_text(const std::string& file) {
  if (file == "-") {
    std::ostringstream text;
    text << std::cin.rdbuf();
    return std::move(text).str();
  }
  auto text = io::program_text(file);
  if (text) return std::move(*text);
  print_error(text.error());
  return std::nullopt;
}

std::unique_ptr<driver::Compilation> open_program(const InputOptions& options, driver::Hooks hooks) {
  auto text = read_text(options.file);
  if (!text) return nullptr;
  driver::Options compile = options.compile;
  for (const std::string& define : options.defines) {
    const auto parts = split_assignment(define, "-D");
    if (!parts) return nullptr;
    compile.defines[parts->first] = parts->second;
  }
  for (const std::string& known : options.known) {
    const auto parts = split_assignment(known, "--known");
    if (!parts) return nullptr;
    const auto numbers = driver::known_value(parts->second);
    if (!numbers)
      return print_error("expected numbers with commas for --known, found '" + parts->second + "'"), nullptr;
    compile.known[parts->first] = *numbers;
  }
  return std::make_unique<driver::Compilation>(shown_name(options.file), *std::move(text), std::move(compile),
                                               std::move(hooks));
}

void tell_error(const driver::Compilation& program) {
  if (program.error()->line != 0)
    print_line_error(program.sources(), program.file(), program.error()->line, program.error()->text);
  else
    print_error(program.error()->text);
}

std::unique_ptr<driver::Compilation> load_graph(const InputOptions& options) {
  driver::Hooks hooks;
  hooks.verify_each = true;
  auto program = open_program(options, std::move(hooks));
  if (!program) return nullptr;
  const bool is_sound = program->lowered() != nullptr;
  report(program->diagnostics(), program->sources());
  if (program->error()) tell_error(*program);
  return is_sound ? std::move(program) : nullptr;
}

std::optional<std::string> load_tree(const InputOptions& options) {
  const auto text = read_text(options.file);
  if (!text) return std::nullopt;
  dsl::SourceManager sources;
  dsl::DiagnosticList diagnostics;
  const dsl::FileId root = sources.add(shown_name(options.file), *text);
  const dsl::Module module = dsl::parse(sources, root, diagnostics);
  report(diagnostics, sources);
  if (diagnostics.has_errors()) return std::nullopt;
  return dsl::dump(module);
}

}  // namespace dr::drc
