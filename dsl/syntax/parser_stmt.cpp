// SPDX-License-Identifier: Apache-2.0
// The parser's part for blocks and statements. The delicate matter is what a block's last expression is:
// its value, or a statement whose `;` is missing.
#include <utility>

#include "dsl/diagnostic/foreign_words.h"
#include "dsl/syntax/parser_impl.h"

namespace dr::dsl {
namespace {

// Whether any branch of an `if` chain ends in a value. In a chain that is still being read, an `else if`
// is a block with an `if` of the same kind as its value.
bool gives_value(const Expr& expr) {
  const Expr* at = &expr;
  while (true) {
    if (at->inner->then_block.value) return true;
    if (!at->inner->else_block || !at->inner->else_block->value) return false;
    const Expr* next = at->inner->else_block->value.get();
    if (next->kind != Expr::Kind::If || next->is_const != expr.is_const) return true;
    at = next;
  }
}

// An `if` as a statement, from the expression it was read as.
StmtPtr if_statement(ExprPtr expr) {
  auto stmt = std::make_unique<Stmt>();
  stmt->kind = expr->is_const ? Stmt::Kind::ConstIf : Stmt::Kind::If;
  stmt->span = expr->span;
  stmt->a = std::move(expr->a);
  stmt->body = std::move(expr->inner->then_block);
  if (expr->inner->else_block) {
    stmt->else_body = std::move(*expr->inner->else_block);
    if (stmt->else_body->value) {
      stmt->else_body->statements.push_back(if_statement(std::move(stmt->else_body->value)));
    }
  }
  return stmt;
}

// What `=` may assign to: a name, or a field or index path rooted in one.
bool is_place(const Expr& expr) {
  const Expr* at = &expr;
  while (at->kind == Expr::Kind::Field || at->kind == Expr::Kind::Index) at = at->a.get();
  return at->kind == Expr::Kind::NameRef;
}

// What `<-` may update: a leaf, by its name or through an instance of a module.
bool is_path(const Expr& expr) {
  const Expr* at = &expr;
  // A tuple's item, as in `pair.0`, is no name.
  while (at->kind == Expr::Kind::Field && (at->name[0] < '0' || at->name[0] > '9')) at = at->a.get();
  return at->kind == Expr::Kind::NameRef;
}

bool is_arithmetic(TokenKind kind) {
  switch (kind) {
    case TokenKind::Plus:
    case TokenKind::Minus:
    case TokenKind::Star:
    case TokenKind::Slash:
    case TokenKind::Percent:
    case TokenKind::And:
    case TokenKind::Or:
    case TokenKind::Xor:
    case TokenKind::ShiftLeft:
    case TokenKind::ShiftRight: return true;
    default: return false;
  }
}

const std::vector<std::string>& statement_words() {
  static const std::vector<std::string> kWords = {"let", "var", "for", "minimize", "output", "return", "const"};
  return kWords;
}

std::unique_ptr<Stmt> make_stmt(Stmt::Kind kind) {
  auto stmt = std::make_unique<Stmt>();
  stmt->kind = kind;
  return stmt;
}

}  // namespace

Block Parser::parse_block(BlockKind kind, const After& after) {
  Block block;
  // A broken header whose body starts right here: the body can be read.
  if (!stopped_ && at(TokenKind::LeftBrace)) panicking_ = false;
  const Token open = token_;
  block.span = Span{file_, open.begin, open.begin};
  if (!expect(TokenKind::LeftBrace, after)) return block;
  const Nest nest(*this);
  const BraceScope braces(*this, true);
  while (!at(TokenKind::RightBrace) && !at(TokenKind::End) && !at_item_boundary()) {
    parse_statement(block);
    if (panicking_) recover(Place::Statement);
    if (panicking_) break;
  }
  expect_close(TokenKind::RightBrace, open, {"the statements of the block"});
  block.span = span_from(open.begin);
  check_returns(block, kind);
  return block;
}

// A misplaced one is a value that nobody uses from then on: what reads a tree with errors meets a 'return' only where
// one may stand.
void Parser::check_returns(Block& block, BlockKind kind) {
  for (size_t i = 0; i < block.statements.size(); ++i) {
    if (block.statements[i]->kind != Stmt::Kind::Return) continue;
    const bool last = i + 1 == block.statements.size() && !block.value;
    if (kind == BlockKind::Function && last) continue;
    report(Code::E0121, block.statements[i]->span,
           std::string("expected 'return' only as the last statement of a function, found it ") +
               (last ? "in another block" : "before other statements"));
    Stmt& stmt = *block.statements[i];
    stmt.kind = Stmt::Kind::Let;
    stmt.pattern.span = stmt.span;
    stmt.pattern.names.push_back({"_", stmt.span});
  }
}

void Parser::parse_statement(Block& block) {
  std::string doc = lexer_.doc(token_);
  statement_begin_ = token_.begin;
  StmtPtr stmt;
  switch (token_.kind) {
    case TokenKind::Let: stmt = parse_let(std::move(doc)); break;
    case TokenKind::Var: stmt = parse_var(std::move(doc)); break;
    case TokenKind::For: stmt = parse_for(); break;
    case TokenKind::Minimize: stmt = parse_minimize(); break;
    case TokenKind::Return: stmt = parse_return(); break;
    case TokenKind::Const: parse_if_statement(block, true); break;
    case TokenKind::If: parse_if_statement(block, false); break;
    case TokenKind::Name:
      if (at_word("break") && (next_at(TokenKind::If) || next_at(TokenKind::Semicolon))) {
        stmt = parse_break();
      } else if (at_word("output") && next_at(TokenKind::Name)) {
        stmt = parse_output();
      } else {
        parse_expression_statement(block);
      }
      break;
    default: parse_expression_statement(block); break;
  }
  if (stmt) block.statements.push_back(std::move(stmt));
}

std::optional<Pattern> Parser::parse_pattern() {
  Pattern pattern;
  const Token open = token_;
  if (take(TokenKind::LeftParen)) {
    do {
      std::optional<Name> name = expect_name("a name", {"", lexer_.text(last_)});
      if (!name) return std::nullopt;
      pattern.names.push_back(*std::move(name));
    } while (take(TokenKind::Comma));
    if (!expect_close(TokenKind::RightParen, open, {"the names"})) return std::nullopt;
    pattern.is_tuple = pattern.names.size() > 1;
  } else {
    std::optional<Name> name = expect_name("a name or '('", {"", lexer_.text(last_)});
    if (!name) return std::nullopt;
    pattern.names.push_back(*std::move(name));
  }
  pattern.span = span_from(open.begin);
  return pattern;
}

StmtPtr Parser::parse_let(std::string doc) {
  StmtPtr stmt = make_stmt(Stmt::Kind::Let);
  stmt->doc = std::move(doc);
  const uint32_t begin = token_.begin;
  advance();
  std::optional<Pattern> pattern = parse_pattern();
  if (!pattern) return nullptr;
  stmt->pattern = *std::move(pattern);
  const std::string& name = stmt->pattern.names.front().text;
  if (take(TokenKind::Colon)) stmt->type = parse_type();
  expect(TokenKind::Assign, {"", name});
  stmt->a = parse_expr();
  stmt->span = span_from(begin);
  expect_semicolon({"the value of", name});
  return stmt;
}

StmtPtr Parser::parse_var(std::string doc) {
  StmtPtr stmt = make_stmt(Stmt::Kind::Var);
  stmt->doc = std::move(doc);
  const uint32_t begin = token_.begin;
  advance();
  std::optional<Name> name = expect_name("a name", {"", "var"});
  if (!name) return nullptr;
  stmt->pattern.span = name->span;
  stmt->pattern.names.push_back(*std::move(name));
  const std::string& text = stmt->pattern.names.front().text;
  if (take(TokenKind::Colon)) stmt->type = parse_type();
  expect(TokenKind::Assign, {"", text});
  stmt->a = parse_expr();
  stmt->span = span_from(begin);
  expect_semicolon({"the value of", text});
  return stmt;
}

StmtPtr Parser::parse_for() {
  StmtPtr stmt = make_stmt(Stmt::Kind::For);
  const uint32_t begin = token_.begin;
  advance();
  std::optional<Name> name = expect_name("the loop's variable", {"", "for"});
  if (!name) return nullptr;
  stmt->loop_var = *std::move(name);
  expect_word("in", {"", stmt->loop_var.text});
  stmt->a = parse_condition();
  expect_range();
  stmt->b = parse_condition();
  if (take(TokenKind::Comma)) {
    expect_word("max", {"", ","});
    expect(TokenKind::Assign, {"", "max"});
    stmt->c = parse_condition();
  }
  stmt->body = parse_block(BlockKind::Other, {"the range"});
  stmt->span = span_from(begin);
  return stmt;
}

StmtPtr Parser::parse_break() {
  StmtPtr stmt = make_stmt(Stmt::Kind::Break);
  const uint32_t begin = token_.begin;
  advance();
  if (take(TokenKind::If)) stmt->a = parse_expr();
  stmt->span = span_from(begin);
  expect_semicolon({stmt->a ? "the condition of" : "", "break"});
  return stmt;
}

StmtPtr Parser::parse_minimize() {
  StmtPtr stmt = make_stmt(Stmt::Kind::Minimize);
  const uint32_t begin = token_.begin;
  advance();
  stmt->a = parse_expr();
  if (at_word("with")) {
    fail_expected(Code::E0101, "'over'", {"the expression"}).help =
        "name what is sought: minimize error over a, b with optim.adam(rate = 0.01)";
    return nullptr;
  }
  expect_word("over", {"the expression"});
  do {
    stmt->targets.push_back(parse_expr());
  } while (take(TokenKind::Comma));
  expect_word("with", {"what to optimize"});
  stmt->b = parse_expr();
  stmt->span = span_from(begin);
  expect_semicolon({"the optimizer"});
  return stmt;
}

StmtPtr Parser::parse_output() {
  StmtPtr stmt = make_stmt(Stmt::Kind::Output);
  const uint32_t begin = token_.begin;
  advance();
  do {
    std::optional<Name> name = expect_name("the name of an output", {"", lexer_.text(last_)});
    if (!name) return nullptr;
    OutputItem& item = stmt->outputs.emplace_back();
    item.name = *std::move(name);
    if (take(TokenKind::Assign)) item.value = parse_expr();
  } while (take(TokenKind::Comma));
  stmt->span = span_from(begin);
  expect_semicolon({"the output", stmt->outputs.back().name.text});
  return stmt;
}

StmtPtr Parser::parse_return() {
  StmtPtr stmt = make_stmt(Stmt::Kind::Return);
  const uint32_t begin = token_.begin;
  advance();
  stmt->a = parse_expr();
  stmt->span = span_from(begin);
  expect_semicolon({"the value of 'return'"});
  return stmt;
}

// An `if` is a statement where its branches have no values; where they have, it is an expression.
void Parser::parse_if_statement(Block& block, bool is_const) {
  const Token first = token_;
  if (is_const) advance();
  if (!at(TokenKind::If)) {
    fail_expected(Code::E0101, "'if'", {"", "const"}).help = "write 'let' in a block";
    return;
  }
  const HeightScope height(*this);
  ExprPtr expr = parse_if(is_const, false);
  expr->span.begin = first.begin;
  if (broken()) return;
  if (!gives_value(*expr)) {
    take(TokenKind::Semicolon);
    block.statements.push_back(if_statement(std::move(expr)));
    return;
  }
  if (!expr->inner->else_block) {
    Diagnostic& diagnostic =
        fail(Code::E0111, expr->span, "expected 'else' after an 'if' that gives a value, found " + found());
    if (!is_const) diagnostic.help = "assign its value with let, or write '=' and ';' in it to change a var";
    return;
  }
  expr = parse_binary_rest(parse_postfix_rest(std::move(expr)), 1);
  finish_expression_statement(block, std::move(expr), first.begin);
}

// A name before something that no expression goes on with.
bool Parser::at_foreign_statement() const {
  if (!at(TokenKind::Name) || instead_of_statement(lexer_.text(token_)) == nullptr) return false;
  if (next_at(TokenKind::Name) || next_at(TokenKind::LeftBrace)) return true;
  if (at_word("continue")) return next_at(TokenKind::Semicolon) || next_at(TokenKind::If);
  if (at_word("print") || at_word("printf")) return next_at(TokenKind::LeftParen);
  return (at_word("while") || at_word("switch") || at_word("elif")) &&
         (next_at(TokenKind::LeftParen) || next_at(TokenKind::Not) || next_at(TokenKind::True));
}

void Parser::parse_expression_statement(Block& block) {
  const uint32_t begin = token_.begin;
  if (at_foreign_statement()) {
    const std::string word = text(token_);
    fail(Code::E0122, span(token_), "expected a statement, found '" + word + "', which is a word of other languages")
        .help = instead_of_statement(word);
    return;
  }
  if (at(TokenKind::Name) && next_at(TokenKind::Name)) {
    // Two names in a row mean nothing; a misspelt keyword does.
    if (const auto nearest = nearest_name(lexer_.text(token_), statement_words())) {
      fail_expected(Code::E0105, "a statement", {}).help = "did you mean '" + *nearest + "'?";
      return;
    }
  }
  if (at(TokenKind::Fn) && next_at(TokenKind::Name)) {
    fail(Code::E0105, span(token_), "expected a statement, found a function with a name").help =
        "declare the function outside, or write 'let " + text(next_) + " = fn(...) { ... };'";
    return;
  }
  const HeightScope height(*this);
  ExprPtr left = parse_unary();
  if (broken()) return;

  // `a <-1.0` inside an expression compares; at the start of a statement it can only be an update.
  if (at(TokenKind::Less) && next_is_adjacent(TokenKind::Minus)) {
    if (!is_path(*left)) {
      fail(Code::E0113, left->span, "expected the name of a param or state before '<-', found an expression");
      return;
    }
    advance();
    advance();
    StmtPtr stmt = make_stmt(Stmt::Kind::Update);
    stmt->target = std::move(left);
    stmt->a = parse_expr();
    stmt->span = span_from(begin);
    const bool named = stmt->target->kind == Expr::Kind::NameRef;
    expect_semicolon(
        {named ? "the next value of" : "the next value", named ? std::string_view(stmt->target->name) : ""});
    block.statements.push_back(std::move(stmt));
    return;
  }
  const TokenKind twice = token_.kind;
  if ((twice == TokenKind::Plus || twice == TokenKind::Minus) && next_is_adjacent(twice) &&
      left->kind == Expr::Kind::NameRef && after_next_is(";")) {
    const std::string op = text(token_);
    fail(Code::E0120, Span{file_, token_.begin, next_.end}, "expected '=' or an operator, found '" + op + op + "'")
        .help = "write '" + left->name.substr(0, 40) + " " + op + "= 1'";
    return;
  }
  std::string_view op;  // of `+=` and its like
  if (is_arithmetic(token_.kind) && next_is_adjacent(TokenKind::Assign)) {
    op = token_text(token_.kind);
    advance();
  }
  if (!at(TokenKind::Assign)) left = parse_binary_rest(std::move(left), 1);
  if (broken()) return;
  if (at(TokenKind::Assign)) {
    if (!is_place(*left)) {
      fail(Code::E0113, left->span, "expected a variable, a field or an item before '=', found another expression");
      return;
    }
    advance();
    StmtPtr stmt = make_stmt(Stmt::Kind::Assign);
    stmt->op = op;
    stmt->target = std::move(left);
    stmt->a = parse_expr();
    stmt->span = span_from(begin);
    const bool plain = stmt->target->kind == Expr::Kind::NameRef;
    expect_semicolon({plain ? "the value of" : "the value", plain ? std::string_view(stmt->target->name) : ""});
    block.statements.push_back(std::move(stmt));
    return;
  }
  finish_expression_statement(block, std::move(left), begin);
}

// The block's value if the block ends here, else a statement.
void Parser::finish_expression_statement(Block& block, ExprPtr expr, uint32_t begin) {
  if (broken()) return;
  if (at(TokenKind::RightBrace)) {
    block.value = std::move(expr);
    return;
  }
  if (expr->kind == Expr::Kind::If) {
    report(Code::E0112, expr->span, "the value of this 'if' is not used").help = "assign its value with let";
    take(TokenKind::Semicolon);
    return;
  }
  StmtPtr stmt = make_stmt(Stmt::Kind::Expr);
  stmt->a = std::move(expr);
  stmt->span = span_from(begin);
  expect_semicolon({"the expression"});
  block.statements.push_back(std::move(stmt));
}

}  // namespace dr::dsl
