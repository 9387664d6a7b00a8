// SPDX-License-Identifier: Apache-2.0
// What a name is, and where it is declared.
#include "compiler/language_server/answers.h"
#include "compiler/language_server/words.h"

namespace dr::language_server {
namespace {

std::string code_block(std::string_view code) { return "```dr\n" + std::string(code) + "\n```\n"; }

// What the lowering found out about a name: here, or where it is declared.
std::string type_words(const Analysis& analysis, uint32_t begin, const dsl::Span& declared) {
  const auto& names = analysis.observation().names;
  const auto here = names.find(begin);
  if (here != names.end() && !here->second.type.empty()) return here->second.type;
  if (!declared.valid() || declared.file != analysis.root()) return "";
  const auto there = names.find(declared.begin);
  return there == names.end() ? "" : there->second.type;
}

std::string module_words(const Analysis& analysis, size_t file) {
  const lower::Observation::File& module = analysis.observation().files[file];
  return code_block("import " + std::string(analysis.sources().name(module.file))) + "\n" + module.syntax.doc;
}

std::string words_of(const Word* word) {
  return word ? code_block(word->signature) + "\n" + std::string(word->text) : "";
}

// A name that has no declaration in any text: the language's own.
std::string own_words(const Analysis& analysis, size_t token, const std::string& type) {
  const std::string_view name = analysis.text(analysis.tokens()[token]);
  const bool behind_dot = token > 0 && analysis.tokens()[token - 1].kind == dsl::TokenKind::Dot;
  if (const Word* word = find_word(name);
      word && (type.empty() || word->is_function) && (!behind_dot || name == "at" || name == "layer"))
    return words_of(word);
  return type.empty() ? "" : code_block(std::string(name) + ": " + type);
}

}  // namespace

Json hover(const Analysis& analysis, uint32_t offset) {
  const size_t token = analysis.token_at(offset);
  if (token == analysis.tokens().size()) return nullptr;
  const dsl::Token& at = analysis.tokens()[token];
  const dsl::Span declared = analysis.declaration_of(token);
  const std::string type = type_words(analysis, at.begin, declared);
  std::string text;
  if (const Declaration* declaration = analysis.find(declared)) {
    text = code_block(declaration->signature);
    // What is written may say less than what it came to.
    if (!type.empty()) text += "\n`" + declaration->name + ": " + type + "`\n";
    if (!declaration->doc.empty()) text += "\n" + declaration->doc;
  } else if (const auto file =
                 declared.valid() && declared.end == 0 ? analysis.place_of(declared.file) : std::nullopt) {
    text = module_words(analysis, *file);
  } else if (const Role* role = analysis.role_of(token)) {
    text = words_of(role->kind == Role::Kind::Keyword ? find_keyword(role->help) : find_word(role->help));
  } else {
    text = own_words(analysis, token, type);
  }
  if (text.empty()) return nullptr;
  return {{"contents", {{"kind", "markdown"}, {"value", text}}},
          {"range", range_json(analysis.lines(), at.begin, at.end)}};
}

Json definition(const Analysis& analysis, uint32_t offset, const std::filesystem::path& library) {
  const size_t token = analysis.token_at(offset);
  if (token == analysis.tokens().size()) return nullptr;
  return location_json(analysis, analysis.declaration_of(token), library);
}

}  // namespace dr::language_server
