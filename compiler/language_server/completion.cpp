// SPDX-License-Identifier: Apache-2.0
// What may be written at a place.
#include <algorithm>
#include <set>

#include "compiler/language_server/answers.h"
#include "compiler/language_server/words.h"
#include "compiler/lower/lower.h"

namespace dr::language_server {
namespace {

using dsl::TokenKind;
using lower::Member;

// CompletionItemKind of the protocol.
enum class ItemKind : int {
  Method = 2,
  Function = 3,
  Field = 5,
  Variable = 6,
  Module = 9,
  Keyword = 14,
  Struct = 22,
  Constant = 21,
  Event = 23,
  TypeParameter = 25
};

ItemKind kind_of(Declaration::Kind kind) {
  switch (kind) {
    case Declaration::Kind::Const: return ItemKind::Constant;
    case Declaration::Kind::Fn: return ItemKind::Function;
    case Declaration::Kind::Struct:
    case Declaration::Kind::Optimizer: return ItemKind::Struct;
    case Declaration::Kind::Step: return ItemKind::Event;
    case Declaration::Kind::Field: return ItemKind::Field;
    case Declaration::Kind::Method: return ItemKind::Method;
    case Declaration::Kind::Generic: return ItemKind::TypeParameter;
    case Declaration::Kind::Leaf:
    case Declaration::Kind::Let:
    case Declaration::Kind::Var:
    case Declaration::Kind::Parameter:
    case Declaration::Kind::Loop: break;
  }
  return ItemKind::Variable;
}

ItemKind kind_of(Member::Kind kind) {
  switch (kind) {
    case Member::Kind::Method: return ItemKind::Method;
    case Member::Kind::Function: return ItemKind::Function;
    case Member::Kind::Constant: return ItemKind::Constant;
    case Member::Kind::Type: return ItemKind::Struct;
    case Member::Kind::Module: return ItemKind::Module;
    case Member::Kind::Step: return ItemKind::Event;
    case Member::Kind::Field: break;
  }
  return ItemKind::Field;
}

class Items {
 public:
  void add(std::string_view label, ItemKind kind, std::string_view detail, std::string_view doc) {
    if (label.empty() || !seen_.insert(std::string(label)).second) return;
    Json item = {{"label", label}, {"kind", static_cast<int>(kind)}};
    if (!detail.empty()) item["detail"] = detail;
    if (!doc.empty()) item["documentation"] = {{"kind", "markdown"}, {"value", doc}};
    list_.push_back(std::move(item));
  }
  void add(const Declaration& declaration, std::string_view type = {}) {
    add(declaration.name, kind_of(declaration.kind), type.empty() ? std::string_view(declaration.signature) : type,
        declaration.doc);
  }
  void add_word(std::string_view name, ItemKind kind) {
    const Word* word = find_word(name);
    add(name, kind, word ? word->signature : "", word ? word->text : "");
  }
  Json take() { return {{"isIncomplete", false}, {"items", std::move(list_)}}; }

 private:
  Json list_ = Json::array();
  std::set<std::string, std::less<>> seen_;
};

bool is_digit(char c) { return std::isdigit(static_cast<unsigned char>(c)) != 0; }
bool is_word(char c) { return std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '_'; }

bool is_name(std::string_view text) {
  return !text.empty() && !is_digit(text[0]) && std::ranges::all_of(text, is_word);
}

// Whether a place is in a comment or a string.
bool is_prose(const Analysis& analysis, uint32_t offset) {
  uint32_t begin = 0;
  for (const dsl::Token& token : analysis.tokens()) {
    if (token.begin >= offset) break;
    if (token.kind == TokenKind::String && offset < token.end) return true;
    if (token.end <= offset) begin = token.end;
  }
  const std::string_view gap = analysis.text().substr(begin, offset - std::min(begin, offset));
  const size_t line = gap.rfind("//");
  return line != std::string_view::npos && gap.find('\n', line) == std::string_view::npos;
}

// `import std.`: the parts of paths that modules have. Nothing where no import is being written.
std::optional<Json> import_items(const Analysis& analysis, uint32_t begin, const std::vector<std::string>& folders) {
  const std::string_view text = analysis.text();
  const size_t line_begin = begin == 0 ? 0 : text.rfind('\n', begin - 1) + 1;
  std::string_view line = text.substr(line_begin, begin - line_begin);
  while (line.starts_with(' ')) line.remove_prefix(1);
  constexpr std::string_view kImport = "import ";
  if (!line.starts_with(kImport)) return std::nullopt;
  std::string prefix(line.substr(kImport.size()));
  if (prefix.find_first_of(" ;") != std::string::npos) return std::nullopt;
  std::ranges::replace(prefix, '.', '/');
  Items items;
  const auto add_path = [&](std::string_view path) {
    if (!path.starts_with(prefix) || !path.ends_with(".dr")) return;
    path.remove_prefix(prefix.size());
    const size_t end = path.find('/');
    items.add(path.substr(0, end == std::string_view::npos ? path.size() - 3 : end), ItemKind::Module, "", "");
  };
  for (const std::string_view path : lower::library_modules()) add_path(path);
  namespace fs = std::filesystem;
  for (const std::string& folder : folders) {
    std::error_code error;
    for (fs::directory_iterator at(fs::path(folder) / prefix, error), end; !error && at != end; at.increment(error)) {
      const std::string name = at->path().filename().string();
      std::error_code ignored;
      if (is_name(name) && at->is_directory(ignored)) items.add(name, ItemKind::Module, "", "");
      add_path(prefix + name);
    }
  }
  return items.take();
}

// What is known of a name that the lowering has not met, by its type as it is written.
void add_members_as_written(const Analysis& analysis, const Declaration& base, Items& items) {
  const auto add = [&](const dsl::Name& name) {
    if (const Declaration* one = analysis.find(name.span)) items.add(*one);
  };
  if (const Declaration* structure = analysis.struct_of(base)) {
    for (const dsl::Param& field : structure->structure->fields) add(field.name);
    for (const dsl::FnDecl& method : structure->structure->methods) add(method.name);
  } else if (base.type && base.type->path.size() == 1) {
    for (const Member& member : lower::members_of_type(base.type->path[0].text))
      items.add_word(member.name, kind_of(member.kind));
  }
}

// What follows a dot. The text is read once more with a word there, so that it is a field.
Json member_items(const Analysis& analysis, uint32_t begin, uint32_t end, const Analyse& analyse) {
  std::string text(analysis.text());
  if (begin == end) text.insert(begin, "member");
  const Analysis patched = analyse(std::move(text), begin);
  Items items;
  for (const Member& member : patched.observation().members) {
    const Declaration* declaration = patched.find(member.declared);
    if (declaration) {
      items.add(*declaration, member.type);
    } else {
      items.add_word(member.name, kind_of(member.kind));
    }
  }
  if (!patched.observation().members.empty()) return items.take();
  // The lowering has not been there: what syntax alone tells.
  const size_t token = patched.token_at(begin);
  if (token == patched.tokens().size() || token < 2) return items.take();
  if (const auto module = patched.module_before(token)) {
    for (const Declaration& one : patched.declared(*module))
      if (!one.is_local && !one.is_private && one.from != one.to) items.add(one);
    return items.take();
  }
  const Declaration* base = patched.find(patched.declaration_of(token - 2));
  if (base) add_members_as_written(patched, *base, items);
  return items.take();
}

// `step_index of `: steps, and what may be an instance that has some.
std::optional<Json> step_items(const Analysis& analysis, uint32_t begin) {
  const std::vector<dsl::Token>& tokens = analysis.tokens();
  const auto behind = std::ranges::lower_bound(tokens, begin, {}, &dsl::Token::begin);
  const auto at = static_cast<size_t>(behind - tokens.begin());
  if (analysis.observation().files.empty() || at < 2) return std::nullopt;
  if (analysis.text(tokens[at - 1]) != "of" || analysis.text(tokens[at - 2]) != "step_index") return std::nullopt;
  Items items;
  for (const Declaration& one : analysis.declared(0))
    if (one.kind == Declaration::Kind::Step || (one.kind == Declaration::Kind::Let && !one.is_local)) items.add(one);
  return items.take();
}

void add_symbols(const dsl::Expr* extent, Items& items) {
  if (!extent) return;
  if (extent->kind == dsl::Expr::Kind::NameRef && extent->name != "_")
    items.add(extent->name, ItemKind::TypeParameter, "int", "");
  if (extent->kind != dsl::Expr::Kind::Binary && extent->kind != dsl::Expr::Kind::Unary) return;
  add_symbols(extent->a.get(), items);
  add_symbols(extent->b.get(), items);
}

Json name_items(const Analysis& analysis, uint32_t offset) {
  Items items;
  if (!analysis.observation().files.empty()) {
    const std::vector<Declaration>& declared = analysis.declared(0);
    const auto& names = analysis.observation().names;
    const auto type_of = [&](const Declaration& one) -> std::string_view {
      const auto known = names.find(one.span.begin);
      return known == names.end() ? std::string_view() : std::string_view(known->second.type);
    };
    // Inner names hide outer ones: the last local one of a name comes first.
    for (auto one = declared.rbegin(); one != declared.rend(); ++one)
      if (one->is_local && offset >= one->from && offset < one->to) items.add(*one, type_of(*one));
    for (const Declaration& one : declared)
      if (!one.is_local && one.from != one.to) items.add(one, type_of(one));
    for (const auto& [name, file] : analysis.observation().files[0].imports)
      items.add(name, ItemKind::Module, "", analysis.observation().files[file].syntax.doc);
    for (const Declaration& one : declared) {
      const bool is_seen = one.kind == Declaration::Kind::Leaf || (offset >= one.from && offset < one.to);
      for (size_t i = 0; is_seen && one.type && i < one.type->extents.size(); ++i)
        add_symbols(one.type->extents[i].get(), items);
    }
  }
  for (const Word& word : words()) {
    if (word.name != "at" && word.name != "layer")
      items.add_word(word.name, word.is_function ? ItemKind::Function : ItemKind::Keyword);
  }
  for (const std::string& name : lower::type_names()) items.add(name, ItemKind::Struct, "", "");
  return items.take();
}

// Of `2.`: no value with fields to show. The item of a tuple, as in `pair.0.`, has some.
bool is_number_before(std::string_view text, size_t dot) {
  size_t begin = dot;
  while (begin > 0 && is_word(text[begin - 1])) --begin;
  return begin < dot && is_digit(text[begin]) && (begin == 0 || text[begin - 1] != '.');
}

}  // namespace

Json completion(const Analysis& analysis, uint32_t offset, const std::vector<std::string>& folders,
                const Analyse& analyse) {
  const std::string_view text = analysis.text();
  if (is_prose(analysis, offset)) return Items().take();
  uint32_t begin = offset, end = offset;
  while (begin > 0 && is_word(text[begin - 1])) --begin;
  while (end < text.size() && is_word(text[end])) ++end;
  if (auto items = import_items(analysis, begin, folders)) return *std::move(items);
  if (begin < offset && is_digit(text[begin])) return Items().take();
  uint32_t before = begin;
  while (before > 0 && std::isspace(static_cast<unsigned char>(text[before - 1])) != 0) --before;
  const bool behind_dot = before > 0 && text[before - 1] == '.' && (before < 2 || text[before - 2] != '.');
  if (behind_dot && is_number_before(text, before - 1)) return Items().take();
  if (behind_dot) return member_items(analysis, begin, end, analyse);
  if (auto items = step_items(analysis, begin)) return *std::move(items);
  return name_items(analysis, offset);
}

}  // namespace dr::language_server
