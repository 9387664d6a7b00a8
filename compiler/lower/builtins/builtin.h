// SPDX-License-Identifier: Apache-2.0
// What a built-in function is, and a call of one. The table of all is builtins.cpp; the elaborator's class has their
// handlers.
#pragma once

#include <string_view>
#include <vector>

#include "compiler/ir/graph.h"
#include "compiler/lower/value.h"
#include "dsl/source/source.h"
#include "dsl/syntax/ast.h"

namespace dr::lower {

class Elaborator;

struct Argument {
  const dsl::Name* name = nullptr;  // null: found by its place
  Value value;
  dsl::Span span;
};

// A call of a built-in function, as its handler sees it.
struct BuiltinCall {
  const Builtin& entry;
  std::vector<Value> args;            // `self` first, then the positional ones; those of a raw entry are not evaluated
  std::vector<dsl::Span> spans;       // parallel to args
  std::vector<Argument> named;        // only names that the entry lists
  const dsl::Expr* syntax = nullptr;  // the call; null when a function value is called by another built-in
  dsl::Span span;
};

struct Builtin {
  std::string_view name;
  size_t min_args = 1;
  size_t max_args = 1;
  Value (Elaborator::*handler)(BuiltinCall&) = nullptr;
  ir::OpKind kind = ir::OpKind::Add;         // for handlers that serve several ops
  std::vector<std::string_view> named = {};  // names that may be given
  bool is_method = false;                    // called as x.name(...): the first argument is x
};

// Arguments after these names are words, not values.
bool is_word_argument(std::string_view name);
// What is written after `name =` in the call, or null.
const dsl::Expr* word_argument(const BuiltinCall& call, std::string_view name);

}  // namespace dr::lower
