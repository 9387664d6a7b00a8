// SPDX-License-Identifier: Apache-2.0
// What a file declares, found in its syntax alone: names at the top level, fields, methods and local names, each with
// where it may be used, what it looks like and what is written about it.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "dsl/source/source.h"
#include "dsl/syntax/ast.h"

namespace dr::language_server {

struct Declaration {
  enum class Kind : uint8_t {
    Const,
    Fn,
    Struct,
    Optimizer,
    Leaf,
    Let,
    Var,
    Step,
    Parameter,
    Field,
    Method,
    Generic,
    Loop
  };
  Kind kind = Kind::Let;
  std::string name;
  dsl::Span span;         // of the name
  std::string signature;  // as written, without a body: "fn project(p: vec3) -> vec2"
  std::string doc;
  bool is_local = false;
  bool is_private = false;
  uint32_t from = 0, to = UINT32_MAX;          // where it may be used; nowhere by its name alone: fields and methods
  const dsl::TypeExpr* type = nullptr;         // as written, if it is
  const dsl::StructDecl* structure = nullptr;  // of a struct
  const std::vector<dsl::Param>* params = nullptr;  // what a call of it gives: parameters or fields
};

// In the order written. The module's tree must outlive the result.
std::vector<Declaration> declarations(const dsl::Module& module, const dsl::SourceManager& sources);

// What a name of its own stands for at a place: the innermost local one, or one of the top level. Null if none does.
const Declaration* find_visible(const std::vector<Declaration>& all, std::string_view name, uint32_t offset);
// The declaration whose name is written there.
const Declaration* find_declared(const std::vector<Declaration>& all, const dsl::Span& name);

}  // namespace dr::language_server
