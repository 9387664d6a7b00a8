// SPDX-License-Identifier: Apache-2.0
// Reading programs for the commands.
#include "compiler/drc/input.h"

#include <cerrno>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <sstream>

#include "compiler/io/file/unreadable.h"
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
  std::ostringstream text;
  if (file == "-") {
    text << std::cin.rdbuf();
    return std::move(text).str();
  }
  std::error_code error;
  std::ifstream in;
  errno = 0;
  if (!std::filesystem::is_directory(file, error)) in.open(file, std::ios::binary);
  if (in.is_open()) text << in.rdbuf();
  if (!in.is_open() || in.bad()) {
    print_error(io::unreadable(file));
    return std::nullopt;
  }
  return std::move(text).str();
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
