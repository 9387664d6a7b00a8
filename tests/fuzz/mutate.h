// SPDX-License-Identifier: Apache-2.0
// Random changes of texts, token by token, so that much of what was sound stays sound.
#pragma once

#include <cstdint>
#include <random>
#include <string>
#include <string_view>
#include <vector>

namespace dr::fuzz {

// Words, numbers, runs of spaces, strings, operators of two characters, single characters. Together they are the text.
std::vector<std::string_view> tokens(std::string_view text);

struct Input {
  std::string text;
  double cost = 0;  // seconds that it ran for
};

class Mutator {
 public:
  // The corpus, which may grow, must stay alive and have at least one text. `words` are texts with tokens to put in.
  Mutator(const std::vector<Input>& corpus, const std::vector<std::string>& words, uint64_t seed);

  // A text of the corpus with one or more changes.
  std::string next();
  // A text of the corpus; of those that take little time, more.
  const std::string& any_text();

 private:
  size_t below(size_t count) { return static_cast<size_t>(random_() % count); }
  std::string any_token();
  std::string change(const std::string& text);

  const std::vector<Input>& corpus_;
  std::vector<std::string> dictionary_;  // the tokens of `words`, each once, and numbers at the edge
  std::mt19937_64 random_;
};

}  // namespace dr::fuzz
