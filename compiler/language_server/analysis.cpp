// SPDX-License-Identifier: Apache-2.0
#include "compiler/language_server/analysis.h"

#include <algorithm>
#include <exception>

#include "compiler/language_server/words.h"
#include "compiler/lower/lower.h"

namespace dr::language_server {

using dsl::Token;
using dsl::TokenKind;

Analysis::Analysis(std::string uri, std::string text, const AnalysisOptions& options)
    : uri_(std::move(uri)),
      root_(sources_.add(path_of_uri(uri_), std::move(text))),
      lines_(std::make_unique<Lines>(sources_.text(root_))) {
  lower_text(options);
  for (const lower::Observation::File& file : observation_.files)
    declared_.push_back(declarations(file.syntax, sources_));
  tokenize();
}

void Analysis::lower_text(const AnalysisOptions& options) {
  observation_.read = [&](const std::string& path) {
    const std::string whole = whole_path(path);
    looked_for_.insert(whole);
    return options.read ? options.read(whole) : std::nullopt;
  };
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
  observation_.read = nullptr;
  shown_ = observation_.messages_of_text.value_or(diagnostics_.all().size());
}

void Analysis::tokenize() {
  dsl::DiagnosticList ignored;
  dsl::Lexer lexer(sources_, root_, ignored);
  for (Token token = lexer.next(); token.kind != TokenKind::End; token = lexer.next()) tokens_.push_back(token);
  roles_ = roles({tokens_, text()}, [&](size_t token) {
    const std::string_view name = text(tokens_[token]);
    const Word* word = find_word(name);
    const bool behind_dot = token > 0 && tokens_[token - 1].kind == TokenKind::Dot;
    const bool hidden = !declared_.empty() && find_visible(declared_[0], name, tokens_[token].begin);
    return word && word->is_function && !behind_dot && !hidden;
  });
}

const Role* Analysis::role_of(size_t token) const {
  const auto found = roles_.find(token);
  return found == roles_.end() ? nullptr : &found->second;
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

// The parameter or field that an argument is for: what the lowering found, or what the callee is as written.
dsl::Span Analysis::declared_as_argument(size_t token, const Role& role) const {
  const dsl::Span here{root_, tokens_[token].begin, tokens_[token].end};
  if (find_declared(declared_[0], here)) return here;  // of a function with generics, a parameter and its default value
  const auto known = observation_.names.find(here.begin);
  if (known != observation_.names.end() && known->second.declared.valid()) return known->second.declared;
  if (role.callee == Role::kNone) return {};
  const dsl::Span callee = declaration_of(role.callee);
  const Declaration* declaration = find(callee);
  const std::vector<dsl::Param>* params = declaration ? declaration->params : nullptr;
  const auto module = callee.valid() && callee.end == 0 ? place_of(callee.file) : std::nullopt;
  if (module) params = &observation_.files[*module].syntax.params;
  if (!params) return {};
  const auto param =
      std::ranges::find(*params, text(tokens_[token]), [](const dsl::Param& one) { return one.name.text; });
  return param == params->end() ? dsl::Span{} : param->name.span;
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
  if (const Role* role = role_of(token); role && role->kind == Role::Kind::Argument)
    return declared_as_argument(token, *role);
  if (const Role* role = role_of(token)) {
    if (role->kind != Role::Kind::Step) return {};
    const auto step = std::ranges::find_if(
        declared_[0], [&](const Declaration& one) { return one.kind == Declaration::Kind::Step && one.name == name; });
    return step == declared_[0].end() ? dsl::Span{} : step->span;
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
