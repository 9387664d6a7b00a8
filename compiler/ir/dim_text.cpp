// SPDX-License-Identifier: Apache-2.0
// Extents as text.
#include <charconv>

#include "compiler/ir/dim_node.h"

namespace dr::ir {
namespace {

using Node = Dim::Node;

constexpr int kMaxParseDepth = 200;
// A literal that fits no coefficient: how the undefined extent prints.
constexpr std::string_view kUndefinedText = "9223372036854775808";

void write_sum(const Dim& d, std::string& out);

void write_number(int64_t number, std::string& out) {
  char buffer[24];
  const auto end = std::to_chars(buffer, buffer + sizeof buffer, number).ptr;
  out.append(buffer, end);
}

// `alone`: nothing binds as tightly as a division beside it.
void write_atom(const Atom& atom, bool alone, std::string& out) {
  if (atom.divisor == 0) {
    out += atom.name;
    return;
  }
  if (!alone) out += '(';
  const Node* inner = Node::of(atom.inner);
  const bool simple = inner && inner->terms.size() == 1;
  if (!simple) out += '(';
  write_sum(atom.inner, out);
  if (!simple) out += ')';
  out += " / ";
  write_number(atom.divisor, out);
  if (!alone) out += ')';
}

void write_sum(const Dim& d, std::string& out) {
  const Node* node = Node::of(d);
  if (!node) return write_number(d.constant(), out);
  if (node->terms.empty()) {
    out += kUndefinedText;
    return;
  }
  bool first = true;
  for (const Term& term : node->terms) {
    const bool negative = term.coefficient < 0;
    const int64_t magnitude = negative ? -term.coefficient : term.coefficient;
    if (first) {
      if (negative) out += '-';
    } else {
      out += negative ? " - " : " + ";
    }
    const bool number = magnitude != 1 || term.atoms.empty();
    if (number) write_number(magnitude, out);
    // A leading minus binds tighter than the division after it.
    const bool alone = term.atoms.size() == 1 && !number && !(first && negative);
    for (size_t i = 0; i < term.atoms.size(); ++i) {
      if (i > 0 || number) out += " * ";
      write_atom(*term.atoms[i], alone, out);
    }
    first = false;
  }
}

class DimParser {
 public:
  explicit DimParser(std::string_view text) : text_(text) {}

  std::optional<Dim> parse() {
    auto d = sum(0);
    skip_spaces();
    if (!d || at_ != text_.size()) return std::nullopt;
    return d;
  }

 private:
  void skip_spaces() {
    while (at_ < text_.size() && (text_[at_] == ' ' || text_[at_] == '\t')) ++at_;
  }
  bool take(char c) {
    skip_spaces();
    if (at_ == text_.size() || text_[at_] != c) return false;
    ++at_;
    return true;
  }

  std::optional<Dim> sum(int depth) {
    auto left = product(depth);
    while (left) {
      const bool plus = take('+');
      if (!plus && !take('-')) break;
      const auto right = product(depth);
      if (!right) return std::nullopt;
      left = plus ? *left + *right : *left - *right;
    }
    return left;
  }

  std::optional<Dim> product(int depth) {
    auto left = unary(depth);
    while (left) {
      const bool times = take('*');
      if (!times && !take('/')) break;
      const auto right = unary(depth);
      if (!right) return std::nullopt;
      if (times) {
        left = *left * *right;
      } else if (right->is_constant() && right->constant() > 0) {
        left = left->divided_by(right->constant());
      } else {
        return std::nullopt;
      }
    }
    return left;
  }

  std::optional<Dim> unary(int depth) {
    if (depth > kMaxParseDepth) return std::nullopt;
    if (take('-')) {
      const auto operand = unary(depth + 1);
      if (!operand) return std::nullopt;
      return Dim(0) - *operand;
    }
    if (take('(')) {
      auto inner = sum(depth + 1);
      if (!inner || !take(')')) return std::nullopt;
      return inner;
    }
    skip_spaces();
    const size_t begin = at_;
    while (at_ < text_.size() && is_word(text_[at_])) ++at_;
    const std::string_view word = text_.substr(begin, at_ - begin);
    if (word.empty()) return std::nullopt;
    if (word[0] < '0' || word[0] > '9') return Dim::symbol(std::string(word));
    int64_t number = 0;
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), number);
    if (end != word.data() + word.size()) return std::nullopt;
    // A number beyond the range is an extent all the same, one that no symbols' values make good.
    return error == std::errc::result_out_of_range ? Node::undefined() : Dim(number);
  }

  static bool is_word(char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_';
  }

  std::string_view text_;
  size_t at_ = 0;
};

}  // namespace

std::string Dim::str() const {
  std::string out;
  write_sum(*this, out);
  return out;
}

std::optional<Dim> Dim::parse(std::string_view text) { return DimParser(text).parse(); }

std::string Extent::str() const {
  if (is_unit()) return "";
  std::string out = "[";
  out += w.str();
  if (!h.is_one() || !l.is_one()) out += ", " + h.str();
  if (!l.is_one()) out += ", " + l.str();
  return out + "]";
}

}  // namespace dr::ir
