// SPDX-License-Identifier: Apache-2.0
// Recovering recursive-descent parser: text of one file -> Module. Errors go to `diagnostics`; the
// result is always a usable tree (Expr::Kind::Error where text could not be read).
#pragma once

#include "dsl/diagnostic/diagnostic.h"
#include "dsl/source/source.h"
#include "dsl/syntax/ast.h"
#include "dsl/syntax/lexer.h"

namespace dr::dsl {

inline constexpr int64_t kEdition = 1;  // of the language, the only one

// Nesting deeper than this is an error, never a stack overflow.
inline constexpr int kMaxNesting = 128;

// More operations on top of each other (`a + b + c ...`, `a.b.c ...`) are an error. No path through the
// tree of an expression is longer than this, so whoever walks or destroys the tree may recurse.
inline constexpr int kMaxHeight = 1000;

// The precedence of a binary operator, GLSL's: 1 (`||`) to 10 (`*`). 0 for other tokens.
int precedence(TokenKind kind);

Module parse(const SourceManager& sources, FileId file, DiagnosticList& diagnostics);

// A single expression, for `-D name=value` and JSON-like literals on the command line.
ExprPtr parse_expression(const SourceManager& sources, FileId file, DiagnosticList& diagnostics);

}  // namespace dr::dsl
