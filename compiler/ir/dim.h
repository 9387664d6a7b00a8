// SPDX-License-Identifier: Apache-2.0
// Extent expressions: integers, symbols, and + - * and floor division by a positive constant, kept in
// a normal form so that equality of extents is equality of values. The printed form is also valid GLSL
// and is what bundles store.
#pragma once

#include <compare>
#include <cstdint>
#include <functional>
#include <limits>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace dr::ir {

// Values of the symbols, bound when data is bound.
using SymbolValues = std::map<std::string, int64_t, std::less<>>;

// A polynomial with integer coefficients over atoms; an atom is a symbol or floor(polynomial / constant).
// Immutable. Each distinct expression is kept once, as long as the process lives, so that copies and equality cost
// nothing: extents go with every value.
class Dim {
 public:
  Dim() = default;
  Dim(int64_t constant) : constant_(constant) {  // NOLINT: an integer is an extent
    // The one value whose negation does not fit is left out of the range.
    if (constant == std::numeric_limits<int64_t>::min()) *this = undefined();
  }
  static Dim symbol(std::string name);

  Dim operator+(const Dim& other) const;
  Dim operator-(const Dim& other) const;
  Dim operator*(const Dim& other) const;
  // Floor division. `divisor` > 0.
  Dim divided_by(int64_t divisor) const;

  bool is_constant() const { return node_ == nullptr; }
  bool is_one() const { return node_ == nullptr && constant_ == 1; }
  int64_t constant() const { return constant_; }  // requires is_constant()
  // The symbol's name if this is exactly one symbol.
  std::optional<std::string> as_symbol() const;
  // Names of all symbols inside, sorted, without repeats.
  std::vector<std::string> symbols() const;

  // Value for given symbols; nullopt when one is unbound or the arithmetic overflows.
  std::optional<int64_t> evaluate(const SymbolValues& values) const;
  // A sentence where its value, for all of its symbols, does not fit the int that a program computes with.
  std::optional<std::string> beyond_int(const SymbolValues& values) const;
  // This expression with some symbols replaced.
  Dim substitute(const std::map<std::string, Dim, std::less<>>& replacements) const;
  // This expression with a symbol of the name that `named` gives for each division of products, as V * V / 2: its
  // value may fit a word that V * V does not fit. Sums and products that leave a word on the way come back.
  Dim with_wide_divisions(const std::function<std::string(const Dim& division)>& named) const;

  // "(W + 1) / 2"; parses back with parse().
  std::string str() const;
  static std::optional<Dim> parse(std::string_view text);

  friend bool operator==(const Dim& a, const Dim& b) = default;
  friend std::strong_ordering operator<=>(const Dim& a, const Dim& b);  // any total order, for maps

  struct Node;  // dim.cpp

 private:
  explicit Dim(const Node& node) : constant_(0), node_(&node) {}
  static Dim undefined();
  int64_t constant_ = 1;        // the value when node_ is null, else 0
  const Node* node_ = nullptr;  // null: a constant
};

// Width, height, layers.
struct Extent {
  Dim w, h, l;
  bool is_unit() const { return w.is_one() && h.is_one() && l.is_one(); }
  std::string str() const;  // "[V]" style: trailing ones dropped, "" for a unit extent
  friend bool operator==(const Extent&, const Extent&) = default;
  friend std::strong_ordering operator<=>(const Extent&, const Extent&) = default;
};

// The common extent of element-wise operands: equal, or one of them the literal 1, on each axis.
std::optional<Extent> broadcast(const Extent& a, const Extent& b);

}  // namespace dr::ir
