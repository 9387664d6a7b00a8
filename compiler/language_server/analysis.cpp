// SPDX-License-Identifier: Apache-2.0
#include "compiler/language_server/analysis.h"

#include <algorithm>
#include <exception>

#include "compiler/lower/lower.h"

namespace dr::language_server {

using dsl::Token;
using dsl::TokenKind;

Analysis::Analysis(const std::string& path, std::string text, const AnalysisOptions& options)
    : root_(sources_.add(path, std::move(text))), lines_(std::make_unique<Lines>(sources_.text(root_))) {
  observation_.read = options.read;
  observation_.stop = options.stop;
  observation_.members_at = options.members_at;
  lower::Options lowering;
  lowering.include_dirs = options.include_dirs;
  lowering.defines = options.defines;
  lowering.observation = &observation_;
  try {
    lower::lower(sources_, root_, lowering, diagnostics_);
  } catch (const std::exception& error) {
    internal_error_ = error.what();
  }
  shown_ = observation_.messages_of_text.value_or(diagnostics_.all().size());
  for (const lower::Observation::File& file : observation_.files)
    declared_.push_back(declarations(file.syntax, sources_));
  tokenize();
}

void Analysis::tokenize() {
  dsl::DiagnosticList ignored;
  dsl::Lexer lexer(sources_, root_, ignored);
  for (Token token = lexer.next(); token.kind != TokenKind::End; token = lexer.next()) tokens_.push_back(token);
}

bool Analysis::read_file(std::string_view path) const {
  return std::ranges::any_of(observation_.files,
                             [&](const lower::Observation::File& file) { return sources_.name(file.file) == path; });
}

size_t Analysis::token_at(uint32_t offset) const {
  const auto behind = std::ranges::upper_bound(tokens_, offset, {}, &Token::begin);
  if (behind == tokens_.begin()) return tokens_.size();
  const auto at = static_cast<size_t>(behind - tokens_.begin() - 1);
  const bool at_end = tokens_[at].end == offset;
  // Between `x` and `.` the name is meant.
  if (tokens_[at].begin == offset && at > 0 && tokens_[at].kind != TokenKind::Name && tokens_[at - 1].end == offset)
    return at - 1;
  return offset < tokens_[at].end || at_end ? at : tokens_.size();
}

std::optional<size_t> Analysis::place_of(dsl::FileId file) const {
  for (size_t i = 0; i < observation_.files.size(); ++i)
    if (observation_.files[i].file == file) return i;
  return std::nullopt;
}

const Declaration* Analysis::find(const dsl::Span& name) const {
  const auto place = name.valid() ? place_of(name.file) : std::nullopt;
  return place ? find_declared(declared_[*place], name) : nullptr;
}

std::optional<size_t> Analysis::module_before(size_t token) const {
  if (observation_.files.empty() || token < 2 || tokens_[token - 1].kind != TokenKind::Dot) return std::nullopt;
  const Token& before = tokens_[token - 2];
  const bool is_alone = token == 2 || tokens_[token - 3].kind != TokenKind::Dot;
  if (before.kind != TokenKind::Name || !is_alone) return std::nullopt;
  if (find_visible(declared_[0], text(before), before.begin)) return std::nullopt;
  const auto& imports = observation_.files[0].imports;
  const auto found = imports.find(text(before));
  return found == imports.end() ? std::nullopt : std::optional(found->second);
}

const Declaration* Analysis::struct_of(const Declaration& declaration) const {
  if (!declaration.type || declaration.type->path.empty() || declaration.type->path.size() > 2) return nullptr;
  auto place = place_of(declaration.span.file);
  if (!place) return nullptr;
  const std::vector<dsl::Name>& path = declaration.type->path;
  if (path.size() == 2) {
    const auto& imports = observation_.files[*place].imports;
    const auto module = imports.find(path[0].text);
    if (module == imports.end()) return nullptr;
    place = module->second;
  }
  const Declaration* found = find_visible(declared_[*place], path.back().text, 0);
  return found && found->kind == Declaration::Kind::Struct ? found : nullptr;
}

dsl::Span Analysis::declaration_of(size_t token) const {
  if (token >= tokens_.size() || tokens_[token].kind != TokenKind::Name || observation_.files.empty()) return {};
  const std::string_view name = text(tokens_[token]);
  const uint32_t begin = tokens_[token].begin;
  const lower::Observation::File& root = observation_.files[0];
  for (const dsl::ImportDecl& import : root.syntax.imports) {
    if (begin < import.span.begin || begin >= import.span.end) continue;
    const auto module = root.imports.find((import.alias ? *import.alias : import.path.back()).text);
    return module == root.imports.end() ? dsl::Span{} : dsl::Span{observation_.files[module->second].file, 0, 0};
  }
  if (const auto module = module_before(token)) {
    const Declaration* found = find_visible(declared_[*module], name, 0);
    if (found && !found->is_local) return found->span;
  }
  const bool behind_dot = token > 0 && tokens_[token - 1].kind == TokenKind::Dot;
  const Declaration* visible = behind_dot ? nullptr : find_visible(declared_[0], name, begin);
  // A module: its file.
  if (const auto module = root.imports.find(name); module != root.imports.end() && !behind_dot && !visible)
    return {observation_.files[module->second].file, 0, 0};
  const auto known = observation_.names.find(begin);
  if (known != observation_.names.end() && known->second.declared.valid()) return known->second.declared;
  const dsl::Span here{root_, begin, tokens_[token].end};
  if (find_declared(declared_[0], here)) return here;
  if (behind_dot) {
    // `light.power` in a function that nobody calls: the parameter's type says what `power` is.
    if (token < 2 || tokens_[token - 2].kind != TokenKind::Name) return {};
    const Declaration* base = find_visible(declared_[0], text(tokens_[token - 2]), tokens_[token - 2].begin);
    const Declaration* structure = base ? struct_of(*base) : nullptr;
    if (!structure) return {};
    for (const dsl::Param& field : structure->structure->fields)
      if (field.name.text == name) return field.name.span;
    for (const dsl::FnDecl& method : structure->structure->methods)
      if (method.name.text == name) return method.name.span;
    return {};
  }
  return visible ? visible->span : dsl::Span{};
}

}  // namespace dr::language_server
