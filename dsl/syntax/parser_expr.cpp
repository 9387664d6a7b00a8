// SPDX-License-Identifier: Apache-2.0
// The parser's part for expressions: precedence climbing over prefix and postfix operators. `height_` is
// kept beside it, so that a chain of a million additions is an error and not a tree of that height.
#include <algorithm>
#include <cctype>
#include <utility>

#include "dsl/syntax/parser_impl.h"

namespace dr::dsl {

int precedence(TokenKind kind) {
  switch (kind) {
    case TokenKind::OrOr: return 1;
    case TokenKind::AndAnd: return 2;
    case TokenKind::Or: return 3;
    case TokenKind::Xor: return 4;
    case TokenKind::And: return 5;
    case TokenKind::Equal:
    case TokenKind::NotEqual: return 6;
    case TokenKind::Less:
    case TokenKind::LessEqual:
    case TokenKind::Greater:
    case TokenKind::GreaterEqual: return 7;
    case TokenKind::ShiftLeft:
    case TokenKind::ShiftRight: return 8;
    case TokenKind::Plus:
    case TokenKind::Minus: return 9;
    case TokenKind::Star:
    case TokenKind::Slash:
    case TokenKind::Percent: return 10;
    default: return 0;
  }
}

namespace {

const std::vector<std::string>& reductions() {
  static const std::vector<std::string> kNames = {"sum", "min", "max", "argmin"};
  return kNames;
}

const std::vector<std::string>& raster_functions() {
  static const std::vector<std::string> kNames = {"setup", "corner", "depth", "keep", "tag", "cull"};
  return kNames;
}

bool contains(const std::vector<std::string>& names, std::string_view name) {
  for (const std::string& known : names) {
    if (known == name) return true;
  }
  return false;
}

// 'sum', 'min', 'max' or 'argmin'
std::string one_of(const std::vector<std::string>& names) {
  std::string text;
  for (size_t i = 0; i < names.size(); ++i) {
    if (i > 0) text += i + 1 < names.size() ? ", " : " or ";
    text += "'" + names[i] + "'";
  }
  return text;
}

}  // namespace

ExprPtr Parser::node(Expr::Kind kind) const {
  auto expr = std::make_unique<Expr>();
  expr->kind = kind;
  expr->span = span(token_);
  switch (kind) {
    case Expr::Kind::Lambda:
    case Expr::Kind::If:
    case Expr::Kind::Reduce:
    case Expr::Kind::Fold:
    case Expr::Kind::Raster:
    case Expr::Kind::BlockExpr: expr->inner = std::make_unique<Expr::Inner>(); break;
    default: break;
  }
  return expr;
}

ExprPtr Parser::error_expr() const {
  ExprPtr expr = node(Expr::Kind::Error);
  expr->span.end = expr->span.begin;
  return expr;
}

// One more operation on top of the tree being read.
void Parser::grow() {
  if (++height_ <= kMaxHeight || broken()) return;
  fail(Code::E0107, span(last_),
       "expected at most " + std::to_string(kMaxHeight) + " operations on top of each other, found more")
      .help = "name a part of the expression with let";
  stop();
}

ExprPtr Parser::parse_expr() { return parse_operand(1); }

// Up to the `{` that starts the body.
ExprPtr Parser::parse_condition() {
  const BraceScope braces(*this, false);
  return parse_expr();
}

ExprPtr Parser::parse_operand(int min_precedence) {
  if (broken()) return error_expr();
  const HeightScope height(*this);
  return parse_binary_rest(parse_unary(), min_precedence);
}

ExprPtr Parser::parse_binary_rest(ExprPtr left, int min_precedence) {
  while (!broken()) {
    const int level = precedence(token_.kind);
    if (level == 0 || level < min_precedence) break;
    ExprPtr binary = node(Expr::Kind::Binary);
    binary->op = token_text(token_.kind);
    advance();
    binary->a = std::move(left);
    binary->b = parse_operand(level + 1);
    binary->span = join(binary->a->span, binary->b->span);
    left = std::move(binary);
    grow();
  }
  return left;
}

ExprPtr Parser::parse_unary() {
  switch (token_.kind) {
    case TokenKind::Minus:
    case TokenKind::Not:
    case TokenKind::Tilde: {
      const Nest nest(*this);
      if (broken()) return error_expr();
      ExprPtr unary = node(Expr::Kind::Unary);
      unary->op = token_text(token_.kind);
      advance();
      unary->a = parse_unary();
      unary->span = join(unary->span, unary->a->span);
      grow();
      return unary;
    }
    default: return parse_postfix_rest(parse_primary());
  }
}

ExprPtr Parser::parse_postfix_rest(ExprPtr expr) {
  while (!broken()) {
    const uint32_t begin = expr->span.begin;
    if (at(TokenKind::Dot)) {
      expr = parse_field_rest(std::move(expr));
    } else if (at(TokenKind::LeftBracket)) {
      const Token open = token_;
      ExprPtr index = node(Expr::Kind::Index);
      advance();
      const Nest nest(*this);
      const BraceScope braces(*this, true);
      index->a = std::move(expr);
      index->b = parse_expr();
      if (at(TokenKind::Comma)) {
        fail_expected(Code::E0101, "']'", {"the index"}).help =
            "write x.at(ivec2(i, j)) for the element of an image in column i and row j, and m[i][j] for a matrix";
      }
      expect_close(TokenKind::RightBracket, open, {"the index"});
      expr = std::move(index);
    } else if (at_fold(*expr)) {
      expr = parse_fold(std::move(expr->name), begin);
    } else if (at(TokenKind::LeftParen)) {
      ExprPtr call = node(Expr::Kind::Call);
      call->a = std::move(expr);
      call->args = parse_args({}, true);
      expr = std::move(call);
    } else {
      break;
    }
    expr->span = span_from(begin);
    grow();
  }
  return expr;
}

ExprPtr Parser::parse_field_rest(ExprPtr expr) {
  ExprPtr field = node(Expr::Kind::Field);
  field->a = std::move(expr);
  advance();
  if (at(TokenKind::Int)) {
    // No tuple has that many elements, and whoever reads the number may rely on it.
    constexpr size_t kMaxDigits = 9;
    if (token_.end - token_.begin > kMaxDigits) {
      report(Code::E0008, span(token_), "expected a tuple index of at most 9 digits, found " + found());
    } else {
      field->name = text(token_);
    }
    advance();
    return field;
  }
  if (std::optional<Name> name = expect_name("the name of a field", {"", "."})) field->name = std::move(name->text);
  return field;
}

std::vector<Arg> Parser::parse_args(const After& after, bool may_be_empty) {
  std::vector<Arg> args;
  const Token open = token_;
  if (!expect(TokenKind::LeftParen, after)) return args;
  const Nest nest(*this);
  const BraceScope braces(*this, true);
  if (may_be_empty && take(TokenKind::RightParen)) return args;
  do {
    Arg& arg = args.emplace_back();
    if (at(TokenKind::Name) && next_at(TokenKind::Assign)) {
      arg.name = take_name_token();
      advance();
    }
    arg.value = parse_expr();
  } while (take(TokenKind::Comma));
  expect_close(TokenKind::RightParen, open, {"the arguments"});
  return args;
}

ExprPtr Parser::parse_primary() {
  if (broken()) return error_expr();
  if (height_ < 1) height_ = 1;
  switch (token_.kind) {
    case TokenKind::Int:
    case TokenKind::Float: return parse_number();
    case TokenKind::True:
    case TokenKind::False: {
      ExprPtr expr = node(Expr::Kind::Bool);
      expr->bool_value = at(TokenKind::True);
      advance();
      return expr;
    }
    case TokenKind::String: {
      ExprPtr expr = node(Expr::Kind::String);
      expr->name = string_value(lexer_.text(token_));
      advance();
      return expr;
    }
    case TokenKind::Name: {
      ExprPtr expr = node(Expr::Kind::NameRef);
      expr->name = text(token_);
      advance();
      if (expr->name == "step_index" && at_word("of") && next_at(TokenKind::Name)) return parse_step_count(*expr);
      return expr;
    }
    case TokenKind::LeftParen: return parse_paren_or_tuple();
    case TokenKind::LeftBracket: return parse_array();
    case TokenKind::LeftBrace: {
      if (!brace_allowed_) {
        fail(Code::E0102, span(token_), "expected an expression before the '{' of the body, found none");
        return error_expr();
      }
      ExprPtr expr = node(Expr::Kind::BlockExpr);
      expr->inner->then_block = parse_block(BlockKind::Other, {});
      expr->span = expr->inner->then_block.span;
      grow();
      return expr;
    }
    case TokenKind::If: return parse_if(false, true);
    case TokenKind::Const: {
      const Token first = token_;
      advance();
      if (!at(TokenKind::If)) {
        fail_expected(Code::E0101, "'if'", {"", "const"});
        return error_expr();
      }
      ExprPtr expr = parse_if(true, true);
      expr->span.begin = first.begin;
      return expr;
    }
    case TokenKind::Reduce: return parse_reduce();
    case TokenKind::Fn: return parse_lambda();
    case TokenKind::Raster: return parse_raster();
    default: break;
  }
  if (token_.begin == statement_begin_) {
    fail_expected(Code::E0105, "a statement", {});
  } else {
    Diagnostic& diagnostic = fail_expected(
        Code::E0102, "an expression", {"", last_.kind == TokenKind::End ? std::string_view() : lexer_.text(last_)});
    if (at(TokenKind::Dot) && next_is_adjacent(TokenKind::Int)) diagnostic.help = "write a digit before the '.'";
    if (at(TokenKind::Star) && last_.kind == TokenKind::Star) diagnostic.help = "write pow(a, b), or a * a";
  }
  return error_expr();
}

// `step_index of fit`, of `rig.fit` where the step is an instance's.
ExprPtr Parser::parse_step_count(const Expr& word) {
  ExprPtr expr = node(Expr::Kind::StepCount);
  advance();  // of
  std::vector<Name> path{take_name_token()};
  while (at(TokenKind::Dot) && next_at(TokenKind::Name)) {
    advance();
    path.push_back(take_name_token());
  }
  expr->a = path_to_expr(std::move(path));
  expr->span = join(word.span, expr->a->span);
  return expr;
}

ExprPtr Parser::parse_number() {
  const bool is_int = at(TokenKind::Int);
  ExprPtr expr = node(is_int ? Expr::Kind::Int : Expr::Kind::Float);
  const std::string_view digits = lexer_.text(token_);
  if (is_int) {
    expr->unsigned_suffix = digits.ends_with('u');
    if (const std::optional<int64_t> value = int_value(digits)) {
      expr->int_value = *value;
      expr->name = digits;
    } else {
      report(Code::E0008, span(token_), "expected an integer of at most 63 bits, found " + found());
    }
  } else if (const std::optional<double> value = float_value(digits)) {
    expr->float_value = *value;
  } else {
    report(Code::E0008, span(token_), "expected a number in the range of float, found " + found());
  }
  advance();
  return expr;
}

ExprPtr Parser::parse_paren_or_tuple() {
  const Token open = token_;
  ExprPtr expr = node(Expr::Kind::Tuple);
  advance();
  const Nest nest(*this);
  const BraceScope braces(*this, true);
  if (!take(TokenKind::RightParen)) {
    ExprPtr first = parse_expr();
    if (!at(TokenKind::Comma)) {
      expect_close(TokenKind::RightParen, open, {"the expression"});
      first->span = span_from(open.begin);
      return first;
    }
    expr->items.push_back(std::move(first));
    while (take(TokenKind::Comma)) {
      if (at(TokenKind::RightParen) && expr->items.size() == 1) {
        report(Code::E0117, Span{file_, open.begin, token_.end}, "expected two or more elements in a tuple, found one");
        break;
      }
      expr->items.push_back(parse_expr());
    }
    expect_close(TokenKind::RightParen, open, {"the elements of the tuple"});
  }
  expr->span = span_from(open.begin);
  grow();
  return expr;
}

ExprPtr Parser::parse_array() {
  const Token open = token_;
  ExprPtr expr = node(Expr::Kind::Array);
  advance();
  const Nest nest(*this);
  const BraceScope braces(*this, true);
  do {
    expr->items.push_back(parse_expr());
  } while (take(TokenKind::Comma));
  expect_close(TokenKind::RightBracket, open, {"the items of the array"});
  expr->span = span_from(open.begin);
  grow();
  return expr;
}

ExprPtr Parser::parse_if(bool is_const, bool needs_else) {
  const uint32_t begin = token_.begin;
  const bool starts_statement = begin == statement_begin_;
  ExprPtr expr = node(Expr::Kind::If);
  expr->is_const = is_const;
  advance();
  {
    const Nest nest(*this);
    expr->a = parse_condition();
  }
  const bool damaged = panicking_;
  expr->inner->then_block = parse_block(BlockKind::Other, {"the condition"});
  // What was read as the body may have been the condition: nothing is known about what follows.
  if (damaged && !at(TokenKind::Else)) panicking_ = true;
  if (take(TokenKind::Else)) {
    if (at(TokenKind::If)) {
      const Nest nest(*this);
      Block chained;
      chained.value = parse_if(is_const, needs_else);
      chained.span = chained.value->span;
      expr->inner->else_block = std::move(chained);
    } else {
      expr->inner->else_block = parse_block(BlockKind::Other, {"", "else"});
    }
  } else if (needs_else && !broken()) {
    Diagnostic& diagnostic = fail_expected(Code::E0111, "'else'", {"the block of 'if'"});
    if (starts_statement) diagnostic.help = "assign its value with let";
  }
  // Whoever reads the tree finds both branches of an `if` that gives a value.
  if (needs_else && !expr->inner->else_block) expr->inner->else_block.emplace().span = span_from(last_.end);
  expr->span = span_from(begin);
  grow();
  return expr;
}

ExprPtr Parser::parse_reduce() {
  const uint32_t begin = token_.begin;
  ExprPtr expr = node(Expr::Kind::Reduce);
  advance();
  const Token open = token_;
  if (!expect(TokenKind::LeftParen, {"", "reduce"})) return error_expr();
  {
    const Nest nest(*this);
    const BraceScope braces(*this, true);
    std::optional<Name> name = expect_name(one_of(reductions()), {"", "("});
    if (!name) return error_expr();
    if (!contains(reductions(), name->text)) {
      Diagnostic& diagnostic =
          report(Code::E0118, name->span, "expected " + one_of(reductions()) + ", found " + describe(last_));
      suggest(diagnostic, name->text, reductions());
    }
    expr->name = std::move(name->text);
    expect(TokenKind::Comma, {"the reduction", expr->name});
    std::optional<Name> loop_var = expect_name("the loop's variable", {"", ","});
    if (!loop_var) return error_expr();
    expr->inner->loop_var = *std::move(loop_var);
    expect_word("in", {"", expr->inner->loop_var.text});
    expr->a = parse_expr();
    expect_range();
    expr->b = parse_expr();
    if (take(TokenKind::Comma)) {
      expect_word("max", {"", ","});
      expect(TokenKind::Assign, {"", "max"});
      expr->c = parse_expr();
    }
    expect_close(TokenKind::RightParen, open, {"the range"});
  }
  expr->inner->then_block = parse_block(BlockKind::Other, {"the range"});
  expr->span = span_from(begin);
  grow();
  return expr;
}

// `fold` and `scan` are words only where `(k in` follows: elsewhere they are names like any other.
bool Parser::at_fold(const Expr& callee) const {
  if (callee.kind != Expr::Kind::NameRef || !at(TokenKind::LeftParen)) return false;
  if (callee.name != "fold" && callee.name != "scan") return false;
  if (!next_at(TokenKind::Name)) return false;
  return after_next_is("in");
}

// Whether the token behind the next one is this.
bool Parser::after_next_is(std::string_view wanted) const {
  std::string_view rest = sources_.text(file_).substr(next_.end);
  const auto skip = [&](size_t count) { rest.remove_prefix(std::min(count, rest.size())); };
  for (skip(rest.find_first_not_of(" \t\r\n")); rest.starts_with("//"); skip(rest.find_first_not_of(" \t\r\n")))
    skip(rest.find('\n'));
  if (!rest.starts_with(wanted)) return false;
  const auto is_word = [](char c) { return std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '_'; };
  return !is_word(wanted.back()) || rest.size() == wanted.size() || !is_word(rest[wanted.size()]);
}

ExprPtr Parser::parse_fold(std::string word, uint32_t begin) {
  ExprPtr expr = node(Expr::Kind::Fold);
  expr->name = std::move(word);
  const Token open = token_;
  advance();
  {
    const Nest nest(*this);
    const BraceScope braces(*this, true);
    expr->inner->loop_var = take_name_token();
    advance();  // in
    expr->a = parse_expr();
    expect_range();
    expr->b = parse_expr();
    while (take(TokenKind::Comma)) {
      std::optional<Name> name = expect_name("the name of a carried value or 'max'", {"", ","});
      if (!name) return error_expr();
      expect(TokenKind::Assign, {"", name->text});
      ExprPtr value = parse_expr();
      if (name->text == "max") {
        expr->c = std::move(value);
      } else {
        expr->args.push_back({*std::move(name), std::move(value)});
      }
    }
    expect_close(TokenKind::RightParen, open, {"the range and the carried values"});
  }
  expr->inner->then_block = parse_block(BlockKind::Other, {"the carried values"});
  expr->span = span_from(begin);
  grow();
  return expr;
}

ExprPtr Parser::parse_lambda() {
  const uint32_t begin = token_.begin;
  ExprPtr expr = node(Expr::Kind::Lambda);
  advance();
  parse_signature_and_body(expr->inner->fn, {"", "fn"}, true);
  expr->inner->fn.span = span_from(begin);
  expr->inner->fn.name.span = Span{file_, begin, begin + 2};
  expr->span = expr->inner->fn.span;
  grow();
  return expr;
}

ExprPtr Parser::parse_raster() {
  const uint32_t begin = token_.begin;
  ExprPtr expr = node(Expr::Kind::Raster);
  advance();
  expr->args = parse_args({"", "raster"}, false);
  if (panicking_ && !stopped_ && at(TokenKind::LeftBrace)) panicking_ = false;
  const Token open = token_;
  if (expect(TokenKind::LeftBrace, {"the arguments of 'raster'"})) {
    const Nest nest(*this);
    while (!at(TokenKind::RightBrace) && !at(TokenKind::End) && !at_item_boundary()) {
      parse_raster_fn(expr->inner->raster_fns);
      if (panicking_) recover(Place::Statement);
      if (panicking_) break;
    }
    expect_close(TokenKind::RightBrace, open, {"the functions of 'raster'"});
  }
  expr->span = span_from(begin);
  grow();
  return expr;
}

void Parser::parse_raster_fn(std::vector<FnDecl>& fns) {
  FnDecl fn;
  fn.doc = lexer_.doc(token_);
  const uint32_t begin = token_.begin;
  if (!at(TokenKind::Name)) {
    fail_expected(Code::E0101, "a function of 'raster' or '}'", {});
    advance();  // it may begin a statement, where recover() stops
    return;
  }
  const std::string shown = found();
  fn.name = take_name_token();
  const bool known = contains(raster_functions(), fn.name.text);
  if (!known) {
    Diagnostic& diagnostic =
        report(Code::E0114, fn.name.span, "expected " + one_of(raster_functions()) + ", found " + shown);
    suggest(diagnostic, fn.name.text, raster_functions());
  }
  for (const FnDecl& other : fns) {
    if (!known || other.name.text != fn.name.text) continue;
    report(Code::E0115, fn.name.span, "expected one function " + shown + ", found a second")
        .notes.push_back({other.name.span, "the first one is here"});
    break;
  }
  parse_signature_and_body(fn, {"", fn.name.text}, false);
  fn.span = span_from(begin);
  fns.push_back(std::move(fn));
}

}  // namespace dr::dsl
