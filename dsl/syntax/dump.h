// SPDX-License-Identifier: Apache-2.0
// A syntax tree as text, for `drc build --emit=ast` and for tests. The form is stable: lists in
// parentheses, an operator or a kind in front, broken into lines where they are long.
#pragma once

#include <string>

#include "dsl/syntax/ast.h"

namespace dr::dsl {

std::string dump(const Module& module);  // ends with a newline
std::string dump(const Expr& expr);      // the same form, without a newline at the end

}  // namespace dr::dsl
