// SPDX-License-Identifier: Apache-2.0
// Words of other languages, and what to write here. Each function gives null for a word that it does not know.
#pragma once

#include <string_view>

namespace dr::dsl {

const char* instead_of_statement(std::string_view word);    // `while (a) {`
const char* instead_of_declaration(std::string_view word);  // `def f(x)` at the top level
const char* instead_of_operator(std::string_view word);     // `a and b`
const char* instead_of_name(std::string_view word);         // `zeros(4)`, `np.sum(x)`
const char* instead_of_field(std::string_view word);        // `x.shape`

}  // namespace dr::dsl
