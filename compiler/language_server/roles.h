// SPDX-License-Identifier: Apache-2.0
// Names whose place says what they are, so that none of them is looked up as the name of a value: those of arguments
// and of outputs, steps, and words such as the axes of a sum. Found in the tokens alone, also of a broken text.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <string_view>
#include <vector>

#include "dsl/syntax/lexer.h"

namespace dr::language_server {

struct Role {
  enum class Kind : uint8_t {
    Argument,  // `rate` of `adam(rate = 0.1)`
    Output,    // `loss` of `output loss = mean(x);`
    Step,      // `fit` of `step_index of fit`
    Word,      // `sum` of `reduce(sum, …)`, `x` of `over = x`
    Keyword    // `step` of `step fit { … }`, which is a function elsewhere
  };
  static constexpr size_t kNone = SIZE_MAX;
  Kind kind = Kind::Word;
  size_t callee = kNone;  // Argument: the token that names what is called, if a name does
  std::string_view help;  // the word of the language that explains it, or empty
};

struct Tokens {
  const std::vector<dsl::Token>& all;
  std::string_view text;  // that they are of
  std::string_view operator[](size_t token) const {
    return text.substr(all[token].begin, all[token].end - all[token].begin);
  }
};

// By the token. `is_builtin` tells whether a token names a function of the language.
std::map<size_t, Role> roles(const Tokens& tokens, const std::function<bool(size_t token)>& is_builtin);

}  // namespace dr::language_server
