// SPDX-License-Identifier: Apache-2.0
#include "tests/fuzz/mutate.h"

#include <algorithm>
#include <cctype>
#include <set>

namespace dr::fuzz {

namespace {

constexpr std::string_view kNumbers[] = {"0",
                                         "1",
                                         "2",
                                         "-1",
                                         "4096",
                                         "2147483647",
                                         "2147483648",
                                         "4294967295",
                                         "9223372036854775807",
                                         "9223372036854775808",
                                         "0.0",
                                         "1e38",
                                         "1e39",
                                         "1e-45",
                                         "1e400",
                                         "nan",
                                         "inf"};

constexpr std::string_view kPairs[] = {"==", "!=", "<=", ">=", "&&", "||", "<<", ">>", "<-", "->", "..", "//"};

bool is_word(char c) { return std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '_'; }
bool is_space(char c) { return c == ' ' || c == '\n' || c == '\t' || c == '\r'; }

template <class Predicate>
size_t run_length(std::string_view text, Predicate predicate) {
  return static_cast<size_t>(std::find_if_not(text.begin(), text.end(), predicate) - text.begin());
}

size_t token_length(std::string_view text) {
  if (is_word(text[0])) return run_length(text, is_word);
  if (is_space(text[0])) return run_length(text, is_space);
  if (text[0] == '"') {
    const size_t end = text.find_first_of("\"\n", 1);
    return end == std::string_view::npos ? text.size() : end + 1;
  }
  return std::ranges::find(kPairs, text.substr(0, 2)) != std::end(kPairs) ? 2 : 1;
}

}  // namespace

std::vector<std::string_view> tokens(std::string_view text) {
  std::vector<std::string_view> result;
  while (!text.empty()) {
    result.push_back(text.substr(0, token_length(text)));
    text.remove_prefix(result.back().size());
  }
  return result;
}

Mutator::Mutator(const std::vector<Input>& corpus, const std::vector<std::string>& words, uint64_t seed)
    : corpus_(corpus), random_(seed) {
  std::set<std::string_view> known(std::begin(kNumbers), std::end(kNumbers));
  for (const std::string& text : words) {
    const auto parts = tokens(text);
    known.insert(parts.begin(), parts.end());
  }
  dictionary_.assign(known.begin(), known.end());
}

const std::string& Mutator::any_text() {
  const Input* chosen = &corpus_[below(corpus_.size())];
  if (below(8) == 0) return chosen->text;
  for (int k = 0; k < 3; ++k) {
    const Input& other = corpus_[below(corpus_.size())];
    if (other.cost < chosen->cost) chosen = &other;
  }
  return chosen->text;
}

std::string Mutator::any_token() {
  if (below(5) == 0) return std::string(kNumbers[below(std::size(kNumbers))]);
  return dictionary_[below(dictionary_.size())];
}

// One change.
std::string Mutator::change(const std::string& text) {
  if (text.empty()) return any_token();
  // Of bytes: rarely in a text, often in what is none.
  if (below(text.find('\0') == std::string::npos ? 12 : 2) == 0) {
    std::string result = text;
    const size_t at = below(result.size());
    switch (below(3)) {
      case 0: result[at] = static_cast<char>(below(256)); break;
      case 1: result.resize(at); break;
      default: result.insert(at, 1, static_cast<char>(below(256))); break;
    }
    return result;
  }
  const std::vector<std::string_view> old = tokens(text);
  const auto join = [](const auto& parts, size_t begin, size_t end) {
    std::string joined;
    for (size_t i = begin; i < end; ++i) joined += parts[i];
    return joined;
  };
  const size_t begin = below(old.size());
  const size_t end = std::min(old.size(), begin + 1 + below(below(3) == 0 ? 40 : 3));
  std::string middle;
  switch (below(8)) {
    case 0: break;  // removed
    case 1: middle = join(old, begin, end) + join(old, begin, end); break;
    case 2: {  // a part of this text again, here
      const size_t from = below(old.size());
      middle = join(old, from, std::min(old.size(), from + end - begin));
      break;
    }
    case 3: {  // a part of another text
      const std::vector<std::string_view> other = tokens(any_text());
      if (other.empty()) break;
      const size_t from = below(other.size());
      middle = join(other, from, std::min(other.size(), from + 1 + below(60)));
      break;
    }
    case 4: middle = join(old, begin, end) + any_token(); break;
    case 5: {  // changes places with what follows
      const size_t next = std::min(old.size(), end + (end - begin));
      return join(old, 0, begin) + join(old, end, next) + join(old, begin, end) + join(old, next, old.size());
    }
    default: middle = any_token() + join(old, begin + 1, end); break;
  }
  return join(old, 0, begin) + middle + join(old, end, old.size());
}

std::string Mutator::next() {
  std::string text = any_text();
  do {
    text = change(text);
  } while (below(5) < 2);
  return text;
}

}  // namespace dr::fuzz
