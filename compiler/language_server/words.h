// SPDX-License-Identifier: Apache-2.0
// The words that the language itself gives a meaning, with a line about each: words.txt,
// which is part of the program, and the entries of ops that programs call.
#pragma once

#include <string_view>
#include <vector>

namespace dr::language_server {

struct Word {
  std::string_view name;
  std::string_view signature;
  std::string_view text;
  bool is_function = false;  // one that is called; the others are keywords and names such as `param`
};

const std::vector<Word>& words();
// Null where the language gives the word no meaning.
const Word* find_word(std::string_view name);
// Of a word that is a function, too: what it is where it is none.
const Word* find_keyword(std::string_view name);

}  // namespace dr::language_server
