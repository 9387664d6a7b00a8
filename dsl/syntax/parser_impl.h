// SPDX-License-Identifier: Apache-2.0
// The parser's class, private to dsl/parser*.cpp. How errors work: the first one of a statement sets
// `panicking_`, which silences the rest and lets every function return without taking tokens; the loop
// over statements or items then skips to a place where reading makes sense again (`recover`).
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "dsl/diagnostic/diagnostic.h"
#include "dsl/source/source.h"
#include "dsl/syntax/ast.h"
#include "dsl/syntax/lexer.h"
#include "dsl/syntax/parser.h"

namespace dr::dsl {

class Parser {
 public:
  Parser(const SourceManager& sources, FileId file, DiagnosticList& diagnostics);
  Module parse_module();
  ExprPtr parse_single_expression();

 private:
  enum class BlockKind : uint8_t { Function, Other };
  enum class Place : uint8_t { Item, Statement };

  // What a missing token should have followed: `the value of 'x'`. Made into text only for a message.
  struct After {
    std::string_view what;
    std::string_view name = {};
  };

  // One level of brackets, blocks or prefix operators. Every cycle of the grammar passes through one.
  class Nest {
   public:
    explicit Nest(Parser& parser);
    ~Nest() { --parser_.nesting_; }
    Nest(const Nest&) = delete;
    Nest& operator=(const Nest&) = delete;

   private:
    Parser& parser_;
  };

  // Measures the tree that is read while it lives: `height_` starts at 0, operations add to it, and the
  // tree around it takes the maximum.
  class HeightScope {
   public:
    explicit HeightScope(Parser& parser) : parser_(parser), outer_(parser.height_) { parser.height_ = 0; }
    ~HeightScope() {
      if (parser_.height_ < outer_) parser_.height_ = outer_;
    }
    HeightScope(const HeightScope&) = delete;
    HeightScope& operator=(const HeightScope&) = delete;

   private:
    Parser& parser_;
    int outer_;
  };

  // Whether a `{` may start an expression: not in a condition or a range, whose end it marks.
  class BraceScope {
   public:
    BraceScope(Parser& parser, bool allowed) : parser_(parser), outer_(parser.brace_allowed_) {
      parser.brace_allowed_ = allowed;
    }
    ~BraceScope() { parser_.brace_allowed_ = outer_; }
    BraceScope(const BraceScope&) = delete;
    BraceScope& operator=(const BraceScope&) = delete;

   private:
    Parser& parser_;
    bool outer_;
  };

  // Tokens (parser.cpp).
  bool at(TokenKind kind) const { return token_.kind == kind; }
  bool at_word(std::string_view word) const { return token_.kind == TokenKind::Name && lexer_.text(token_) == word; }
  bool next_at(TokenKind kind) const { return next_.kind == kind; }
  bool at_private() const {
    return at_word("private") &&
           (next_at(TokenKind::Const) || next_at(TokenKind::Fn) || next_at(TokenKind::Let) || next_at(TokenKind::Name));
  }
  bool next_is_adjacent(TokenKind kind) const { return next_.kind == kind && next_.begin == token_.end; }
  void advance();
  bool take(TokenKind kind);
  void stop();
  Span span(const Token& token) const { return Span{file_, token.begin, token.end}; }
  Span span_from(uint32_t begin) const;  // to the end of the last token taken
  std::string text(const Token& token) const { return std::string(lexer_.text(token)); }
  Name take_name_token();

  // Errors (parser.cpp). `report` goes on with the next token, `fail` leaves the statement.
  bool broken() const { return panicking_ || stopped_; }
  Diagnostic& report(Code code, const Span& span, std::string message);
  Diagnostic& fail(Code code, const Span& span, std::string message);
  Diagnostic& fail_expected(Code code, std::string_view what, const After& after);
  bool expect(TokenKind kind, const After& after);
  bool expect_word(std::string_view word, const After& after);
  bool expect_semicolon(const After& after);
  bool expect_range();
  bool expect_close(TokenKind kind, const Token& open, const After& after);
  std::optional<Name> expect_name(std::string_view what, const After& after);
  void add_open_note(Diagnostic& diagnostic, const Token& open) const;
  std::string describe(const Token& token) const;
  std::string found() const { return describe(token_); }
  void suggest(Diagnostic& diagnostic, std::string_view name, const std::vector<std::string>& known);

  // Recovery (parser.cpp).
  bool starts_item() const;
  bool at_item_boundary() const;
  bool starts_statement() const;
  void recover(Place place);

  // Items (parser_decl.cpp).
  void parse_edition(Module& module);
  void parse_import(Module& module);
  void parse_module_params(Module& module);
  void parse_item(Module& module);
  void fail_item();
  std::unique_ptr<ConstDecl> parse_const(std::string doc);
  std::unique_ptr<FnDecl> parse_fn(std::string doc);
  std::unique_ptr<FnDecl> parse_vjp_fn(std::string doc);
  std::unique_ptr<StructDecl> parse_struct(std::string doc);
  std::unique_ptr<OptimizerDecl> parse_optimizer(std::string doc);
  void parse_update(OptimizerDecl& optimizer);
  std::unique_ptr<LeafDecl> parse_leaf(LeafDecl::Kind kind, bool needs_type, std::string doc);
  std::unique_ptr<StepDecl> parse_step(std::string doc);
  std::vector<Name> parse_generics();
  std::vector<Param> parse_params(const After& after, bool may_be_empty);
  std::optional<Param> parse_param();
  void parse_signature_and_body(FnDecl& fn, const After& after, bool params_may_be_empty);

  // Types (parser_decl.cpp).
  TypePtr parse_type();
  TypePtr parse_tuple_type();
  void parse_named_type_rest(TypeExpr& type);
  void parse_generic_args(TypeExpr& type);
  void parse_generic_arg(TypePtr& type, ExprPtr& value);
  ExprPtr path_to_expr(std::vector<Name> path);
  void parse_extents(TypeExpr& type);
  bool expect_close_angle(const Token& open);

  // Statements (parser_stmt.cpp).
  Block parse_block(BlockKind kind, const After& after);
  void parse_statement(Block& block);
  StmtPtr parse_let(std::string doc);
  StmtPtr parse_var(std::string doc);
  StmtPtr parse_for();
  StmtPtr parse_minimize();
  StmtPtr parse_output();
  StmtPtr parse_return();
  StmtPtr parse_break();
  void parse_if_statement(Block& block, bool is_const);
  bool at_foreign_statement() const;
  void parse_expression_statement(Block& block);
  void finish_expression_statement(Block& block, ExprPtr expr, uint32_t begin);
  void check_returns(Block& block, BlockKind kind);
  std::optional<Pattern> parse_pattern();

  // Expressions (parser_expr.cpp).
  ExprPtr node(Expr::Kind kind) const;
  ExprPtr error_expr() const;
  ExprPtr parse_expr();
  ExprPtr parse_condition();
  ExprPtr parse_operand(int min_precedence);
  ExprPtr parse_binary_rest(ExprPtr left, int min_precedence);
  ExprPtr parse_unary();
  ExprPtr parse_postfix_rest(ExprPtr expr);
  ExprPtr parse_field_rest(ExprPtr expr);
  ExprPtr parse_primary();
  ExprPtr parse_step_count(const Expr& word);
  ExprPtr parse_number();
  ExprPtr parse_paren_or_tuple();
  ExprPtr parse_array();
  ExprPtr parse_if(bool is_const, bool needs_else);
  ExprPtr parse_reduce();
  bool after_next_is(std::string_view text) const;
  bool at_fold(const Expr& callee) const;
  ExprPtr parse_fold(std::string word, uint32_t begin);
  ExprPtr parse_lambda();
  ExprPtr parse_raster();
  void parse_raster_fn(std::vector<FnDecl>& fns);
  std::vector<Arg> parse_args(const After& after, bool may_be_empty);
  void grow();

  const SourceManager& sources_;
  FileId file_;
  DiagnosticList& diagnostics_;
  Lexer lexer_;
  Token token_;
  Token next_;
  Token last_;  // the last token taken
  int nesting_ = 0;
  int height_ = 0;
  bool brace_allowed_ = true;
  bool panicking_ = false;
  bool stopped_ = false;
  uint32_t statement_begin_ = UINT32_MAX;
  Diagnostic ignored_;  // what silenced errors write to
};

}  // namespace dr::dsl
