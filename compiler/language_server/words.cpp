// SPDX-License-Identifier: Apache-2.0
#include "compiler/language_server/words.h"

#include <algorithm>

#include "compiler/lower/lower.h"
#include "compiler/ops/op.h"

namespace dr::language_server {
namespace {

constexpr std::string_view kText =
#include "words.inc"
    ;

// Functions that the op table offers, by what their entries say.
std::vector<Word> words_of_ops() {
  static const std::vector<std::string> kSignatures = [] {
    std::vector<std::string> all;
    for (const ir::OpKind kind : ir::all_op_kinds()) {
      static constexpr const char* kOperands[] = {"()", "(x)", "(x, y)", "(x, y, z)"};
      const ops::OpInfo& info = ops::info(kind);
      if (info.is_function) all.push_back(std::string(ir::op_name(kind)) + kOperands[info.domains.size()]);
    }
    return all;
  }();
  std::vector<Word> all;
  for (const ir::OpKind kind : ir::all_op_kinds())
    if (ops::info(kind).is_function)
      all.push_back({ir::op_name(kind), kSignatures[all.size()], ops::info(kind).doc, true});
  return all;
}

// `NAME(x) | text`, or `NAME signature | text` where the signature starts with something else.
std::vector<Word> read_words() {
  std::vector<std::string> functions = lower::builtin_names();
  functions.insert(functions.end(), {"at", "layer"});
  std::vector<Word> all = words_of_ops();
  for (std::string_view rest = kText; !rest.empty();) {
    const std::string_view line = rest.substr(0, rest.find('\n'));
    rest.remove_prefix(std::min(line.size() + 1, rest.size()));
    const size_t bar = line.find(" | ");
    if (bar == std::string_view::npos) continue;
    const size_t end = line.find_first_of("( ");
    Word word{line.substr(0, end), line.substr(0, bar), line.substr(bar + 3)};
    if (line[end] == ' ') word.signature.remove_prefix(end + 1);
    const bool is_called = line[end] == '(' || word.signature.starts_with("x.");
    word.is_function = is_called && std::ranges::find(functions, word.name) != functions.end();
    all.push_back(word);
  }
  return all;
}

}  // namespace

const std::vector<Word>& words() {
  static const std::vector<Word> kWords = read_words();
  return kWords;
}

const Word* find_word(std::string_view name) {
  const auto found = std::ranges::find(words(), name, &Word::name);
  return found == words().end() ? nullptr : &*found;
}

const Word* find_keyword(std::string_view name) {
  const auto found =
      std::ranges::find_if(words(), [&](const Word& word) { return word.name == name && !word.is_function; });
  return found == words().end() ? nullptr : &*found;
}

}  // namespace dr::language_server
