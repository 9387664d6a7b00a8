// SPDX-License-Identifier: Apache-2.0
// The parser's part for items (what stands at the top level of a file), parameters and types.
#include <utility>

#include "dsl/diagnostic/foreign_words.h"
#include "dsl/syntax/parser_impl.h"

namespace dr::dsl {
namespace {

// Binary operators from here up may stand in a generic argument, whose end is a `>`.
constexpr int kAdditivePrecedence = 9;

const std::vector<std::string>& item_words() {
  static const std::vector<std::string> kWords = {"const",   "fn",      "struct",    "optimizer", "param",
                                                  "input",   "state",   "let",       "step",      "import",
                                                  "edition", "private", "parameters"};
  return kWords;
}

}  // namespace

// ---- items ----

void Parser::parse_edition(Module& module) {
  module.edition = kEdition;
  const Token first = token_;
  if (!at_word("edition")) {
    // A misspelt 'edition' is not a missing one.
    if (at(TokenKind::Name) && next_at(TokenKind::Int)) {
      fail_item();
      return;
    }
    const std::string message = "expected 'edition' at the start of the file, found " + found();
    report(Code::E0108, span(first), message).help =
        "write 'edition " + std::to_string(kEdition) + ";' as the first line";
    // What does not even start a declaration would only be complained about again.
    panicking_ = !starts_item();
    return;
  }
  module.doc = lexer_.doc(token_);
  advance();
  if (!at(TokenKind::Int)) {
    fail_expected(Code::E0101, "the number of the edition", {"", "edition"});
    return;
  }
  const std::optional<int64_t> edition = int_value(lexer_.text(token_));
  advance();
  module.edition_span = span_from(first.begin);
  if (edition != kEdition) {
    report(Code::E0109, span(last_),
           "expected edition " + std::to_string(kEdition) + ", found edition " + describe(last_) +
               ", which is not supported");
  }
  module.edition = edition.value_or(kEdition);
  expect_semicolon({"the edition"});
}

void Parser::parse_import(Module& module) {
  ImportDecl import;
  const uint32_t begin = token_.begin;
  advance();
  do {
    std::optional<Name> name = expect_name("the name of a module", {"", lexer_.text(last_)});
    if (!name) return;
    import.path.push_back(*std::move(name));
  } while (take(TokenKind::Dot));
  if (at_word("as")) {
    advance();
    import.alias = expect_name("a name", {"", "as"});
  }
  import.span = span_from(begin);
  expect_semicolon({"the import of", import.path.back().text});
  module.imports.push_back(std::move(import));
}

void Parser::fail_item() {
  const std::string message = "expected a declaration such as 'fn', 'let' or 'param', found " + found();
  Diagnostic& diagnostic = fail(Code::E0104, span(token_), message);
  if (at(TokenKind::For) || at(TokenKind::If) || at(TokenKind::Minimize))
    diagnostic.help = instead_of_declaration("while");
  if (!at(TokenKind::Name)) return;
  if (const char* help = instead_of_declaration(lexer_.text(token_)))
    diagnostic.help = help;
  else
    suggest(diagnostic, lexer_.text(token_), item_words());
}

// `parameters (size, rate = 0.1);`
void Parser::parse_module_params(Module& module) {
  const Token first = token_;
  const bool again = module.params_span.valid();
  if (again || !module.items.empty()) {
    report(Code::E0110, span(first),
           again ? "expected 'parameters' once in a file, found it again"
                 : "expected 'parameters' before all declarations, found it behind them");
  }
  advance();
  std::vector<Param> params = parse_params({"", "parameters"}, true);
  if (!again) {
    module.params = std::move(params);
    module.params_span = span_from(first.begin);
  }
  expect_semicolon({"the parameters"});
}

void Parser::parse_item(Module& module) {
  std::string doc = lexer_.doc(token_);
  Item item;
  if (at_private()) {
    const Span word = span(token_);
    advance();
    item.is_private = true;
    if (!at(TokenKind::Const) && !at(TokenKind::Fn) && !at_word("struct") && !at_word("optimizer")) {
      report(Code::E0123, word,
             "expected 'private' before 'const', 'fn', 'struct' or 'optimizer', found it before " + found());
    }
  }
  if (at(TokenKind::Const)) {
    item.kind = Item::Kind::Const;
    item.constant = parse_const(std::move(doc));
  } else if (at(TokenKind::Fn)) {
    item.kind = Item::Kind::Fn;
    item.fn = parse_fn(std::move(doc));
  } else if (at(TokenKind::At)) {
    item.kind = Item::Kind::Fn;
    item.fn = parse_vjp_fn(std::move(doc));
  } else if (at(TokenKind::Let)) {
    item.kind = Item::Kind::Statement;
    item.statement = parse_let(std::move(doc));
  } else if (at_word("struct")) {
    item.kind = Item::Kind::Struct;
    item.structure = parse_struct(std::move(doc));
  } else if (at_word("optimizer")) {
    item.kind = Item::Kind::Optimizer;
    item.optimizer = parse_optimizer(std::move(doc));
  } else if (at_word("param") || at_word("input") || at_word("state")) {
    item.kind = Item::Kind::Leaf;
    item.leaf = parse_leaf(at_word("param")   ? LeafDecl::Kind::Param
                           : at_word("input") ? LeafDecl::Kind::Input
                                              : LeafDecl::Kind::State,
                           true, std::move(doc));
  } else if (at_word("step")) {
    item.kind = Item::Kind::Step;
    item.step = parse_step(std::move(doc));
  } else if (at_word("import")) {
    if (!module.items.empty() || module.params_span.valid()) {
      report(Code::E0110, span(token_), "expected imports before all declarations, found one behind them");
    }
    parse_import(module);
    return;
  } else if (at_word("parameters") && next_at(TokenKind::LeftParen)) {
    parse_module_params(module);
    return;
  } else if (at_word("edition") && next_at(TokenKind::Int)) {
    fail(Code::E0110, span(token_), "expected 'edition' once, at the start of the file, found it again");
    return;
  } else {
    fail_item();
    return;
  }
  if (item.constant || item.fn || item.structure || item.optimizer || item.leaf || item.statement || item.step) {
    module.items.push_back(std::move(item));
  }
}

std::unique_ptr<ConstDecl> Parser::parse_const(std::string doc) {
  auto decl = std::make_unique<ConstDecl>();
  decl->doc = std::move(doc);
  const uint32_t begin = token_.begin;
  advance();
  std::optional<Name> name = expect_name("the name of a constant", {"", "const"});
  if (!name) return nullptr;
  decl->name = *std::move(name);
  if (take(TokenKind::Colon)) decl->type = parse_type();
  expect(TokenKind::Assign, {"", decl->name.text});
  decl->value = parse_expr();
  decl->span = span_from(begin);
  expect_semicolon({"the value of", decl->name.text});
  return decl;
}

void Parser::parse_signature_and_body(FnDecl& fn, const After& after, bool params_may_be_empty) {
  fn.params = parse_params(after, params_may_be_empty);
  if (take(TokenKind::Arrow)) fn.result = parse_type();
  const std::string_view header = fn.result ? "the result type" : "the parameters";
  fn.body = parse_block(BlockKind::Function, {header});
}

std::unique_ptr<FnDecl> Parser::parse_fn(std::string doc) {
  auto fn = std::make_unique<FnDecl>();
  fn->doc = std::move(doc);
  const uint32_t begin = token_.begin;
  advance();
  std::optional<Name> name = expect_name("the name of a function", {"", "fn"});
  if (!name) return nullptr;
  fn->name = *std::move(name);
  fn->generics = parse_generics();
  parse_signature_and_body(*fn, {"", fn->name.text}, true);
  fn->span = span_from(begin);
  return fn;
}

// `@vjp(f) fn f_vjp(...) { ... }`
std::unique_ptr<FnDecl> Parser::parse_vjp_fn(std::string doc) {
  const uint32_t begin = token_.begin;
  advance();
  if (!expect_word("vjp", {"", "@"}) || !expect(TokenKind::LeftParen, {"", "vjp"})) return nullptr;
  std::optional<Name> of = expect_name("the name of the function whose gradient follows", {"", "("});
  if (!of || !expect(TokenKind::RightParen, {"", of->text})) return nullptr;
  if (!at(TokenKind::Fn)) {
    fail_expected(Code::E0101, "'fn'", {"", "@vjp(" + of->text + ")"});
    return nullptr;
  }
  std::unique_ptr<FnDecl> fn = parse_fn(std::move(doc));
  if (!fn) return nullptr;
  fn->vjp_of = std::move(of);
  fn->span = span_from(begin);
  return fn;
}

std::unique_ptr<StructDecl> Parser::parse_struct(std::string doc) {
  auto decl = std::make_unique<StructDecl>();
  decl->doc = std::move(doc);
  const uint32_t begin = token_.begin;
  advance();
  std::optional<Name> name = expect_name("the name of a struct", {"", "struct"});
  if (!name) return nullptr;
  decl->name = *std::move(name);
  decl->generics = parse_generics();
  const Token open = token_;
  if (!expect(TokenKind::LeftBrace, {"", decl->name.text})) return decl;
  const Nest nest(*this);
  while (!at(TokenKind::RightBrace) && !at(TokenKind::End)) {
    if (at(TokenKind::Fn)) {
      if (std::unique_ptr<FnDecl> method = parse_fn(lexer_.doc(token_))) {
        decl->methods.push_back(std::move(*method));
      }
    } else if (at(TokenKind::Name) && !at_item_boundary()) {
      Param field;
      field.doc = lexer_.doc(token_);
      field.name = take_name_token();
      expect(TokenKind::Colon, {"the field", field.name.text});
      if (!broken()) field.type = parse_type();
      if (take(TokenKind::Assign)) field.default_value = parse_expr();
      expect_semicolon({"the field", field.name.text});
      decl->fields.push_back(std::move(field));
    } else {
      add_open_note(fail_expected(Code::E0101, "a field, a function or '}'", {}), open);
      if (!at_item_boundary()) advance();  // it may begin a statement, where recover() stops
    }
    if (panicking_) recover(Place::Statement);
    if (panicking_) break;
  }
  expect_close(TokenKind::RightBrace, open, {"the fields"});
  decl->span = span_from(begin);
  return decl;
}

std::unique_ptr<OptimizerDecl> Parser::parse_optimizer(std::string doc) {
  auto decl = std::make_unique<OptimizerDecl>();
  decl->doc = std::move(doc);
  const uint32_t begin = token_.begin;
  advance();
  std::optional<Name> name = expect_name("the name of an optimizer", {"", "optimizer"});
  if (!name) return nullptr;
  decl->name = *std::move(name);
  decl->params = parse_params({"", decl->name.text}, true);
  const Token open = token_;
  if (!expect(TokenKind::LeftBrace, {"the parameters"})) return decl;
  const Nest nest(*this);
  bool has_update = false;
  bool damaged = false;
  while (!at(TokenKind::RightBrace) && !at(TokenKind::End)) {
    if (at_word("state")) {
      if (has_update) report(Code::E0101, span(token_), "expected each 'state' before 'update', found one behind it");
      if (std::unique_ptr<LeafDecl> state = parse_leaf(LeafDecl::Kind::State, false, lexer_.doc(token_))) {
        decl->states.push_back(std::move(*state));
      }
    } else if (at_word("update")) {
      if (has_update) {
        report(Code::E0115, span(token_), "expected one 'update' in an optimizer, found a second")
            .notes.push_back({decl->update.name.span, "the first one is here"});
      }
      has_update = true;
      parse_update(*decl);
    } else if (at_item_boundary()) {
      break;
    } else {
      Diagnostic& diagnostic = fail_expected(Code::E0101, "'state', 'update' or '}'", {});
      if (at(TokenKind::Name)) suggest(diagnostic, lexer_.text(token_), {"state", "update"});
      advance();  // it may begin a statement, where recover() stops
    }
    damaged = damaged || panicking_;
    if (panicking_) recover(Place::Statement);
    if (panicking_) break;
  }
  if (at(TokenKind::RightBrace) && !has_update && !damaged) {
    report(Code::E0119, span(token_), "expected 'update' in the optimizer '" + decl->name.text + "', found '}'");
  }
  expect_close(TokenKind::RightBrace, open, {"the parts of the optimizer"});
  decl->span = span_from(begin);
  return decl;
}

void Parser::parse_update(OptimizerDecl& optimizer) {
  FnDecl update;
  update.doc = lexer_.doc(token_);
  const uint32_t begin = token_.begin;
  update.name = take_name_token();
  update.params = parse_params({"", "update"}, false);
  update.body = parse_block(BlockKind::Function, {"the parameters"});
  update.span = span_from(begin);
  optimizer.update = std::move(update);
}

std::unique_ptr<LeafDecl> Parser::parse_leaf(LeafDecl::Kind kind, bool needs_type, std::string doc) {
  auto decl = std::make_unique<LeafDecl>();
  decl->kind = kind;
  decl->doc = std::move(doc);
  const Token first = token_;
  advance();
  std::optional<Name> name = expect_name("a name", {"", lexer_.text(first)});
  if (!name) return nullptr;
  decl->name = *std::move(name);
  if (needs_type ? expect(TokenKind::Colon, {"", decl->name.text}) : take(TokenKind::Colon)) {
    decl->type = parse_type();
  }
  if (take(TokenKind::Assign)) decl->initial = parse_expr();
  decl->span = span_from(first.begin);
  expect_semicolon({decl->initial ? "the value of" : "the type of", decl->name.text});
  return decl;
}

std::unique_ptr<StepDecl> Parser::parse_step(std::string doc) {
  auto decl = std::make_unique<StepDecl>();
  decl->doc = std::move(doc);
  const uint32_t begin = token_.begin;
  advance();
  std::optional<Name> name = expect_name("the name of a step", {"", "step"});
  if (!name) return nullptr;
  decl->name = *std::move(name);
  decl->body = parse_block(BlockKind::Other, {"", decl->name.text});
  decl->span = span_from(begin);
  return decl;
}

// ---- parameters ----

std::vector<Name> Parser::parse_generics() {
  std::vector<Name> generics;
  const Token open = token_;
  if (!take(TokenKind::Less)) return generics;
  do {
    std::optional<Name> name = expect_name("a name", {"", lexer_.text(last_)});
    if (!name) return generics;
    generics.push_back(*std::move(name));
  } while (take(TokenKind::Comma));
  expect_close(TokenKind::Greater, open, {"the generic names"});
  return generics;
}

std::vector<Param> Parser::parse_params(const After& after, bool may_be_empty) {
  std::vector<Param> params;
  const Token open = token_;
  if (!expect(TokenKind::LeftParen, after)) return params;
  const Nest nest(*this);
  const BraceScope braces(*this, true);
  if (may_be_empty && take(TokenKind::RightParen)) return params;
  do {
    if (at(TokenKind::RightParen) && !params.empty()) break;
    std::optional<Param> param = parse_param();
    if (!param) break;
    params.push_back(*std::move(param));
  } while (take(TokenKind::Comma));
  expect_close(TokenKind::RightParen, open, {"the parameters"});
  return params;
}

std::optional<Param> Parser::parse_param() {
  Param param;
  param.is_const = take(TokenKind::Const);
  std::optional<Name> name = expect_name("a parameter", {"", lexer_.text(last_)});
  if (!name) return std::nullopt;
  param.name = *std::move(name);
  if (take(TokenKind::Colon)) param.type = parse_type();
  if (take(TokenKind::Assign)) param.default_value = parse_expr();
  return param;
}

// ---- types ----

TypePtr Parser::parse_type() {
  if (broken()) return nullptr;
  if (at(TokenKind::LeftParen)) return parse_tuple_type();
  auto type = std::make_unique<TypeExpr>();
  const uint32_t begin = token_.begin;
  if (at(TokenKind::Fn)) {
    advance();
    type->kind = TypeExpr::Kind::Function;
  } else if (at(TokenKind::Name)) {
    type->path.push_back(take_name_token());
    while (take(TokenKind::Dot)) {
      std::optional<Name> name = expect_name("the name of a type", {"", type->path.back().text});
      if (!name) break;
      type->path.push_back(*std::move(name));
    }
    parse_named_type_rest(*type);
  } else {
    fail_expected(Code::E0103, "a type", {"", lexer_.text(last_)});
    return nullptr;
  }
  type->span = span_from(begin);
  return type;
}

TypePtr Parser::parse_tuple_type() {
  auto type = std::make_unique<TypeExpr>();
  type->kind = TypeExpr::Kind::Tuple;
  const Token open = token_;
  advance();
  const Nest nest(*this);
  do {
    TypePtr element = parse_type();
    if (!element) break;
    type->elements.push_back(std::move(element));
  } while (take(TokenKind::Comma));
  expect_close(TokenKind::RightParen, open, {"the types of the tuple"});
  type->span = span_from(open.begin);
  if (type->elements.size() < 2) {
    report(Code::E0117, type->span, "expected two or more types in a tuple, found one");
  }
  return type;
}

void Parser::parse_named_type_rest(TypeExpr& type) {
  if (at(TokenKind::Less)) parse_generic_args(type);
  if (at(TokenKind::LeftBracket)) parse_extents(type);
}

void Parser::parse_generic_args(TypeExpr& type) {
  const Token open = token_;
  if (!take(TokenKind::Less)) return;
  const Nest nest(*this);
  const BraceScope braces(*this, true);
  do {
    TypePtr type_arg;
    ExprPtr value_arg;
    parse_generic_arg(type_arg, value_arg);
    if (!type_arg && !value_arg) break;
    type.type_args.push_back(std::move(type_arg));
    type.value_args.push_back(std::move(value_arg));
  } while (take(TokenKind::Comma));
  expect_close_angle(open);
}

// A type or a value. A bare path may be either: it is given as a type, and the name it resolves to
// decides. What an operator follows is a value; `>` ends it, so no comparison can stand here.
void Parser::parse_generic_arg(TypePtr& type, ExprPtr& value) {
  if (broken()) return;
  const HeightScope height(*this);
  const Token first = token_;
  if (at(TokenKind::Fn)) {
    type = parse_type();
    return;
  }
  if (at(TokenKind::LeftParen)) {
    advance();
    const Nest nest(*this);
    TypePtr inner_type;
    ExprPtr inner_value;
    parse_generic_arg(inner_type, inner_value);
    if (inner_value) inner_value = parse_binary_rest(std::move(inner_value), 1);
    if (at(TokenKind::Comma) && inner_type) {
      type = std::make_unique<TypeExpr>();
      type->kind = TypeExpr::Kind::Tuple;
      type->elements.push_back(std::move(inner_type));
      while (take(TokenKind::Comma)) {
        TypePtr element = parse_type();
        if (!element) break;
        type->elements.push_back(std::move(element));
      }
      expect_close(TokenKind::RightParen, first, {"the types of the tuple"});
      type->span = span_from(first.begin);
      return;
    }
    if (inner_type &&
        (inner_type->kind != TypeExpr::Kind::Named || !inner_type->type_args.empty() || inner_type->has_extents)) {
      if (at(TokenKind::RightParen)) {
        report(Code::E0117, inner_type->span, "expected two or more types in a tuple, found one");
      }
      expect_close(TokenKind::RightParen, first, {"the types of the tuple"});
      type = std::move(inner_type);
      return;
    }
    if (inner_type) inner_value = path_to_expr(std::move(inner_type->path));
    expect_close(TokenKind::RightParen, first, {"the expression"});
    if (!inner_value) return;
    inner_value->span = span_from(first.begin);
    value = parse_binary_rest(parse_postfix_rest(std::move(inner_value)), kAdditivePrecedence);
    return;
  }
  if (!at(TokenKind::Name)) {
    value = parse_operand(kAdditivePrecedence);
    return;
  }
  std::vector<Name> path;
  path.push_back(take_name_token());
  while (at(TokenKind::Dot) && next_at(TokenKind::Name)) {
    advance();
    path.push_back(take_name_token());
  }
  switch (token_.kind) {
    case TokenKind::Comma:
    case TokenKind::Greater:
    case TokenKind::GreaterEqual:
    case TokenKind::ShiftRight:
    case TokenKind::RightParen:
    case TokenKind::Less:
    case TokenKind::LeftBracket:
      type = std::make_unique<TypeExpr>();
      type->path = std::move(path);
      parse_named_type_rest(*type);
      type->span = span_from(first.begin);
      return;
    default: value = parse_binary_rest(parse_postfix_rest(path_to_expr(std::move(path))), kAdditivePrecedence); return;
  }
}

ExprPtr Parser::path_to_expr(std::vector<Name> path) {
  ExprPtr expr = node(Expr::Kind::NameRef);
  expr->name = std::move(path.front().text);
  expr->span = path.front().span;
  grow();
  for (size_t i = 1; i < path.size() && !broken(); ++i) {
    ExprPtr field = node(Expr::Kind::Field);
    field->span = join(expr->span, path[i].span);
    field->a = std::move(expr);
    field->name = std::move(path[i].text);
    expr = std::move(field);
    grow();
  }
  return expr;
}

void Parser::parse_extents(TypeExpr& type) {
  const Token open = token_;
  if (!take(TokenKind::LeftBracket)) return;
  const Nest nest(*this);
  const BraceScope braces(*this, true);
  type.has_extents = true;
  if (at(TokenKind::RightBracket)) {
    advance();
    report(Code::E0116, span_from(open.begin), "expected one to three extents, found none");
    return;
  }
  do {
    if (type.extents.size() == 3) {
      fail(Code::E0116, span(token_), "expected at most three extents, found a fourth");
      return;
    }
    type.extents.push_back(parse_expr());
  } while (take(TokenKind::Comma));
  expect_close(TokenKind::RightBracket, open, {"the extents"});
}

// `>>` and `>=` are one token each, except where a generic argument list ends.
bool Parser::expect_close_angle(const Token& open) {
  if (broken()) return false;
  if (at(TokenKind::ShiftRight) || at(TokenKind::GreaterEqual)) {
    last_ = token_;
    last_.kind = TokenKind::Greater;
    last_.end = token_.begin + 1;
    token_.kind = at(TokenKind::ShiftRight) ? TokenKind::Greater : TokenKind::Assign;
    token_.begin += 1;
    token_.first_on_line = false;
    return true;
  }
  return expect_close(TokenKind::Greater, open, {"the generic arguments"});
}

}  // namespace dr::dsl
