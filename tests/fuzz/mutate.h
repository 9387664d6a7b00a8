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

class Mutator {
 public:
  // The corpus must stay alive and have at least one text.
  Mutator(const std::vector<std::string>& corpus, uint64_t seed);

  // A text of the corpus with one or more changes.
  std::string next();

 private:
  size_t below(size_t count) { return static_cast<size_t>(random_() % count); }
  const std::string& any_text() { return corpus_[below(corpus_.size())]; }
  std::string any_token();
  std::string change(const std::string& text);

  const std::vector<std::string>& corpus_;
  std::vector<std::string> dictionary_;  // the tokens of the corpus, each once, and numbers at the edge
  std::mt19937_64 random_;
};

}  // namespace dr::fuzz
