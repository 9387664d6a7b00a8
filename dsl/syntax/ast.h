// SPDX-License-Identifier: Apache-2.0
// The syntax tree of a `.dr` file, as written: nothing is resolved or typed here. The grammar stands
// in docs/reference/language.md, section "Grammar"; names below are its nonterminals.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "dsl/source/source.h"

namespace dr::dsl {

struct Expr;
struct Stmt;
struct TypeExpr;
using ExprPtr = std::unique_ptr<Expr>;
using StmtPtr = std::unique_ptr<Stmt>;
using TypePtr = std::unique_ptr<TypeExpr>;

struct Name {
  std::string text;
  Span span;
};

// A type as written: `vec3[V, 1, N]`, `array<T, K>`, `Camera<float>`, `(vec3, float)`, `fn`.
struct TypeExpr {
  enum class Kind : uint8_t { Named, Tuple, Function };
  Kind kind = Kind::Named;
  Span span;
  std::vector<Name> path;          // Named: `vec3`, or `camera.Pose` as two names
  std::vector<TypePtr> type_args;  // Named: a generic argument that is a type (null where it is a value)
  std::vector<ExprPtr>
      value_args;  // Named: a generic argument that is a value (null where it is a type); parallel to type_args
  std::vector<TypePtr> elements;  // Tuple
  std::vector<ExprPtr> extents;   // 0 to 3; empty brackets are an error
  bool has_extents = false;       // `vec3` (element) and `vec3[1]` (whole image) differ as fn parameters
};

struct Arg {
  std::optional<Name> name;  // named argument `rate = 0.01`
  ExprPtr value;
};

struct Param {
  Name name;
  TypePtr type;           // null: any type, inferred from the argument
  ExprPtr default_value;  // null: required
  bool is_const = false;  // `const K : int`: the argument must be known at compile time
  std::string doc;        // of a field: `///` lines above
};

// `{ statements; value }`: the last expression without `;` is the block's value.
struct Block {
  Span span;
  std::vector<StmtPtr> statements;
  ExprPtr value;  // null: no value
};

// A function's signature and body; also lambdas, struct methods, raster closures, optimizer updates.
struct FnDecl {
  Name name;  // empty text: a lambda
  Span span;
  std::string doc;             // `///` lines above, joined by newlines
  std::vector<Name> generics;  // `fn f<T, K>`
  std::vector<Param> params;
  TypePtr result;  // null: inferred
  Block body;
  std::optional<Name> vjp_of;  // `@vjp(f)`
};

struct Expr {
  enum class Kind : uint8_t {
    Int,        // int_value (text in `name` for overflow messages)
    Float,      // float_value
    Bool,       // bool_value
    String,     // name
    NameRef,    // name
    StepCount,  // `step_index of a`: a names a step
    Unary,      // op, a            op: "-" "!" "~"
    Binary,     // op, a, b         op: + - * / % == != < <= > >= && || & | ^ << >>
    Field,      // a . name         also `t.0` for tuples and `2.px`
    Index,      // a [ b ]          component, matrix column, array item; never a gather
    Call,       // a ( args )
    Lambda,     // fn
    If,         // a = condition, then_block, else_block (always present for an expression); is_const: `const if`
    Reduce,     // reduce(name = sum|min|max|argmin, loop_var in a..b, max = c) body=then_block
    Fold,       // name(loop_var in a..b, args, max = c) body=then_block, name = fold|scan; args: what the loop carries
    Tuple,      // items, 0 or 2+ of them
    Array,      // items
    Raster,     // args as of a call; raster_fns
    BlockExpr,  // then_block
    Error,      // parse error already reported; silences what follows
  };
  Kind kind = Kind::Error;
  Span span;
  std::string name;
  std::string_view op;  // token_text of its token
  int64_t int_value = 0;
  double float_value = 0;
  bool bool_value = false;
  bool is_const = false;
  bool unsigned_suffix = false;  // `3u`
  ExprPtr a, b, c;
  std::vector<Arg> args;
  std::vector<ExprPtr> items;
  // Kept apart, because most expressions have none of it.
  struct Inner {
    Name loop_var;
    Block then_block;
    std::optional<Block> else_block;  // `else if` is a block whose value is an If
    FnDecl fn;
    std::vector<FnDecl> raster_fns;  // setup, corner, depth, keep, tag, cull
  };
  std::unique_ptr<Inner> inner;  // of Lambda, If, Reduce, Fold, Raster, BlockExpr
};

// A pattern on the left of `let`: a name, or a tuple of names (`_` discards).
struct Pattern {
  Span span;
  bool is_tuple = false;
  std::vector<Name> names;
};

struct OutputItem {
  Name name;
  ExprPtr value;  // null: `output alpha;`, the value of that name
};

struct Stmt {
  enum class Kind : uint8_t {
    Let,       // pattern, type?, a
    Var,       // pattern (one name), type?, a
    Assign,    // target = a            target: a name, or a field/index path rooted in a `var`; target op= a
    Update,    // target <- a           target: name of a param or state, through instances of modules too
    Expr,      // a ;
    For,       // loop_var in a..b, max = c body
    If,        // `if a { } else { }` as a statement
    ConstIf,   // `const if a { } else { }` as a statement
    Break,     // `break;` or `break if a;`
    Minimize,  // a over targets with b
    Output,    // outputs
    Return,    // a (only as the last statement of a function)
  };
  Kind kind = Kind::Expr;
  Span span;
  std::string doc;
  Pattern pattern;
  TypePtr type;
  ExprPtr target;
  ExprPtr a, b, c;
  std::string_view op;  // Assign: of `+=` the "+", else empty
  Name loop_var;
  Block body;
  std::optional<Block> else_body;
  std::vector<ExprPtr> targets;  // Minimize: what is optimised
  std::vector<OutputItem> outputs;
};

struct StructDecl {
  Name name;
  Span span;
  std::string doc;
  std::vector<Name> generics;
  std::vector<Param> fields;    // default_value allowed
  std::vector<FnDecl> methods;  // first parameter is `self`
};

struct ConstDecl {
  Name name;
  Span span;
  std::string doc;
  TypePtr type;
  ExprPtr value;
};

// `param`, `input` and `state` leaves.
struct LeafDecl {
  enum class Kind : uint8_t { Param, Input, State };
  Kind kind = Kind::Param;
  Name name;
  Span span;
  std::string doc;
  TypePtr type;     // null only for the state of an optimizer: then that of the parameter it serves
  ExprPtr initial;  // null: bound by the host (zero for a state)
};

// `optimizer adam(rate) { state m = 0; update(x, g) { … } }`
struct OptimizerDecl {
  Name name;
  Span span;
  std::string doc;
  std::vector<Param> params;
  std::vector<LeafDecl> states;
  FnDecl update;
};

struct StepDecl {
  Name name;
  Span span;
  std::string doc;
  Block body;
};

struct ImportDecl {
  std::vector<Name> path;  // import std.camera;  binds `camera`
  Span span;
  std::optional<Name> alias;  // import std.camera as cam;
};

// One top-level item, in the order written: order matters for `let`.
struct Item {
  enum class Kind : uint8_t { Const, Fn, Struct, Optimizer, Leaf, Statement, Step };
  Kind kind = Kind::Statement;
  bool is_private = false;  // Const, Fn, Struct, Optimizer: for files of its folder alone
  std::unique_ptr<ConstDecl> constant;
  std::unique_ptr<FnDecl> fn;
  std::unique_ptr<StructDecl> structure;
  std::unique_ptr<OptimizerDecl> optimizer;
  std::unique_ptr<LeafDecl> leaf;
  StmtPtr statement;  // Let only, at the top level
  std::unique_ptr<StepDecl> step;
};

struct Module {
  FileId file;
  std::string doc;  // `///` lines before `edition`
  int64_t edition = 0;
  Span edition_span;
  std::vector<ImportDecl> imports;
  std::vector<Param> params;  // `parameters (…);`: what an instance is given
  Span params_span;           // not valid: the file has none
  std::vector<Item> items;
};

}  // namespace dr::dsl
