// SPDX-License-Identifier: Apache-2.0
// The normal form of extents. A sum of products of atoms, like terms collected; in a floor division every
// coefficient of the numerator lies in [0, divisor), so that for non-negative symbols the numerator is
// non-negative and the truncating division of C and GLSL is the floor.
#include "compiler/ir/dim.h"

#include <algorithm>
#include <compare>
#include <limits>
#include <memory>
#include <mutex>
#include <numeric>
#include <unordered_map>

#include "compiler/ir/dim_bound.h"
#include "compiler/ir/dim_node.h"

namespace dr::ir {
namespace {

// What an extent's expression may weigh (symbols, terms and divisions together). Real ones weigh less than 50; the
// bound keeps a hostile text from growing without limit. What is heavier is undefined.
constexpr size_t kMaxWeight = 4096;
// Terms that a product may have before like ones are collected.
constexpr size_t kMaxProduct = 1 << 16;

uint64_t mix(uint64_t seed, uint64_t value) {
  seed ^= value + 0x9e3779b97f4a7c15u + (seed << 6) + (seed >> 2);
  return seed * 0xff51afd7ed558ccdu;
}

int64_t floor_div(int64_t a, int64_t b) {  // b > 0
  const int64_t q = a / b;
  return a % b < 0 ? q - 1 : q;
}

bool add_overflows(int64_t a, int64_t b, int64_t* sum) {
  return __builtin_add_overflow(a, b, sum) || *sum == std::numeric_limits<int64_t>::min();
}
bool mul_overflows(int64_t a, int64_t b, int64_t* product) {
  return __builtin_mul_overflow(a, b, product) || *product == std::numeric_limits<int64_t>::min();
}

using Node = Dim::Node;

std::strong_ordering compare(const Atom& a, const Atom& b) {
  if (&a == &b) return std::strong_ordering::equal;
  // Symbols before divisions.
  if (auto c = (a.divisor != 0) <=> (b.divisor != 0); std::is_neq(c)) return c;
  if (a.divisor == 0) return a.name <=> b.name;
  if (auto c = a.inner <=> b.inner; std::is_neq(c)) return c;
  return a.divisor <=> b.divisor;
}

// Products of higher degree first, so that the constant comes last.
std::strong_ordering compare(const std::vector<AtomPtr>& a, const std::vector<AtomPtr>& b) {
  if (auto c = b.size() <=> a.size(); std::is_neq(c)) return c;
  for (size_t i = 0; i < a.size(); ++i) {
    if (auto c = compare(*a[i], *b[i]); std::is_neq(c)) return c;
  }
  return std::strong_ordering::equal;
}

}  // namespace

bool operator==(const Term& a, const Term& b) {
  return a.coefficient == b.coefficient && std::is_eq(compare(a.atoms, b.atoms));
}

namespace {

Dim undefined() { return Node::undefined(); }
bool is_undefined(const Dim& d) { return Node::of(d) && Node::of(d)->terms.empty(); }

// The terms of any defined extent; a constant's go to `storage`.
const std::vector<Term>& terms_of(const Dim& d, std::vector<Term>& storage) {
  if (const Node* node = Node::of(d)) return node->terms;
  if (d.constant() != 0) storage.push_back({{}, d.constant()});
  return storage;
}

// From terms that are sorted and collected.
Dim from_sorted(std::vector<Term> terms) {
  if (terms.empty()) return Dim(0);
  if (terms.size() == 1 && terms[0].atoms.empty()) return Dim(terms[0].coefficient);
  Node node;
  for (const Term& term : terms) {
    node.weight += 1;
    node.hash = mix(node.hash, static_cast<uint64_t>(term.coefficient));
    for (const AtomPtr& atom : term.atoms) {
      node.weight += atom->weight;
      node.hash = mix(node.hash, atom->hash);
    }
  }
  if (node.weight > kMaxWeight) return undefined();
  node.terms = std::move(terms);
  return Node::intern(std::move(node));
}

Dim from_terms(std::vector<Term> terms) {
  std::sort(terms.begin(), terms.end(),
            [](const Term& a, const Term& b) { return std::is_lt(compare(a.atoms, b.atoms)); });
  std::vector<Term> collected;
  for (Term& term : terms) {
    if (collected.empty() || std::is_neq(compare(collected.back().atoms, term.atoms))) {
      if (!collected.empty() && collected.back().coefficient == 0) collected.pop_back();
      collected.push_back(std::move(term));
    } else if (add_overflows(collected.back().coefficient, term.coefficient, &collected.back().coefficient)) {
      return undefined();
    }
  }
  if (!collected.empty() && collected.back().coefficient == 0) collected.pop_back();
  return from_sorted(std::move(collected));
}

Dim alone(const AtomPtr& atom) { return from_sorted({Term{{atom}, 1}}); }
Dim from_atom(Atom atom) { return alone(std::make_shared<const Atom>(std::move(atom))); }

// a + factor * b, by merging.
Dim add_scaled(const Dim& a, const Dim& b, int64_t factor) {
  std::vector<Term> a_storage, b_storage, sum;
  const auto& x = terms_of(a, a_storage);
  const auto& y = terms_of(b, b_storage);
  sum.reserve(x.size() + y.size());
  for (size_t i = 0, j = 0; i < x.size() || j < y.size();) {
    const auto order = i == x.size()   ? std::strong_ordering::greater
                       : j == y.size() ? std::strong_ordering::less
                                       : compare(x[i].atoms, y[j].atoms);
    if (std::is_lt(order)) {
      sum.push_back(x[i++]);
      continue;
    }
    int64_t coefficient = 0;
    if (mul_overflows(y[j].coefficient, factor, &coefficient)) return undefined();
    if (std::is_eq(order) && add_overflows(x[i++].coefficient, coefficient, &coefficient)) return undefined();
    if (coefficient != 0) sum.push_back({y[j].atoms, coefficient});
    ++j;
  }
  return from_sorted(std::move(sum));
}

// The only floor division that is a term of its own with coefficient 1, if there is exactly one.
const Term* single_division(const std::vector<Term>& terms) {
  const Term* found = nullptr;
  for (const Term& term : terms) {
    if (term.coefficient != 1 || term.atoms.size() != 1 || term.atoms[0]->divisor == 0) continue;
    if (found) return nullptr;
    found = &term;
  }
  return found;
}

}  // namespace

Dim Dim::Node::intern(Node node) {
  static std::mutex mutex;
  static std::unordered_multimap<uint64_t, std::unique_ptr<const Node>> nodes;
  const std::scoped_lock lock(mutex);
  const auto [begin, end] = nodes.equal_range(node.hash);
  const auto known = std::find_if(begin, end, [&](const auto& entry) { return entry.second->terms == node.terms; });
  if (known != end) return Dim(*known->second);
  const uint64_t hash = node.hash;
  return Dim(*nodes.emplace(hash, std::make_unique<const Node>(std::move(node)))->second);
}

Dim Dim::undefined() {
  static const Dim none = Node::intern(Node{});
  return none;
}

Dim Dim::symbol(std::string name) {
  Atom atom;
  atom.hash = std::hash<std::string>()(name);
  atom.name = std::move(name);
  return from_atom(std::move(atom));
}

Dim Dim::operator+(const Dim& other) const {
  if (!node_ && !other.node_) {
    int64_t sum = 0;
    return add_overflows(constant_, other.constant_, &sum) ? undefined() : Dim(sum);
  }
  if (is_undefined(*this) || is_undefined(other)) return undefined();
  return add_scaled(*this, other, 1);
}

Dim Dim::operator-(const Dim& other) const {
  if (!node_ && !other.node_) return *this + Dim(-other.constant_);
  if (is_undefined(*this) || is_undefined(other)) return undefined();
  return add_scaled(*this, other, -1);
}

Dim Dim::operator*(const Dim& other) const {
  if (!node_ && !other.node_) {
    int64_t product = 0;
    return mul_overflows(constant_, other.constant_, &product) ? undefined() : Dim(product);
  }
  if (is_undefined(*this) || is_undefined(other)) return undefined();
  if (!node_) return constant_ == 1 ? other : add_scaled(Dim(0), other, constant_);
  if (!other.node_) return other.constant_ == 1 ? *this : add_scaled(Dim(0), *this, other.constant_);
  const auto& x = node_->terms;
  const auto& y = other.node_->terms;
  if (x.size() * y.size() > kMaxProduct) return undefined();
  std::vector<Term> products;
  for (const Term& a : x) {
    for (const Term& b : y) {
      Term product;
      if (mul_overflows(a.coefficient, b.coefficient, &product.coefficient)) return undefined();
      product.atoms.resize(a.atoms.size() + b.atoms.size());
      std::merge(a.atoms.begin(), a.atoms.end(), b.atoms.begin(), b.atoms.end(), product.atoms.begin(),
                 [](const AtomPtr& p, const AtomPtr& q) { return std::is_lt(compare(*p, *q)); });
      products.push_back(std::move(product));
    }
  }
  return from_terms(std::move(products));
}

Dim Dim::divided_by(int64_t divisor) const {
  if (divisor <= 0) return undefined();
  if (divisor == 1) return *this;
  if (!node_) return Dim(floor_div(constant_, divisor));
  if (is_undefined(*this)) return undefined();

  // floor((d*q + r) / d) = q + floor(r / d) for an integer q: take the multiples of the divisor out of every
  // coefficient.
  std::vector<Term> quotient, rest;
  for (const Term& term : node_->terms) {
    const int64_t q = floor_div(term.coefficient, divisor);
    const int64_t r = term.coefficient - q * divisor;
    if (q != 0) quotient.push_back({term.atoms, q});
    if (r != 0) rest.push_back({term.atoms, r});
  }
  const Dim outside = from_sorted(std::move(quotient));

  // floor((g*p + c) / (g*d)) = floor((p + floor(c / g)) / d): take out what the divisor shares with all coefficients.
  int64_t shared = divisor;
  for (const Term& term : rest) {
    if (!term.atoms.empty()) shared = std::gcd(shared, term.coefficient);
  }
  const int64_t reduced = divisor / shared;
  for (Term& term : rest) term.coefficient /= shared;
  if (!rest.empty() && rest.back().coefficient == 0) rest.pop_back();
  if (reduced == 1 || rest.empty()) return outside + from_sorted(std::move(rest));

  // floor((floor(x / a) + q) / d) = floor((x + a*q) / (a*d)): a chain of halvings is one division.
  if (const Term* division = single_division(rest)) {
    const AtomPtr atom = division->atoms[0];
    int64_t product = 0;
    if (mul_overflows(atom->divisor, reduced, &product)) return undefined();
    const Dim others = from_sorted(rest) - alone(atom);
    return outside + (atom->inner + others * Dim(atom->divisor)).divided_by(product);
  }

  const Dim numerator = from_sorted(std::move(rest));
  Atom atom;
  atom.inner = numerator;
  atom.divisor = reduced;
  atom.weight = 1 + numerator.node_->weight;
  atom.hash = mix(numerator.node_->hash, static_cast<uint64_t>(reduced));
  return outside + from_atom(std::move(atom));
}

std::optional<std::string> Dim::as_symbol() const {
  if (!node_ || node_->terms.size() != 1) return std::nullopt;
  const Term& term = node_->terms[0];
  if (term.coefficient != 1 || term.atoms.size() != 1 || term.atoms[0]->divisor != 0) return std::nullopt;
  return term.atoms[0]->name;
}

namespace {

void collect_symbols(const Dim& d, std::vector<std::string>& names) {
  if (!Node::of(d)) return;
  for (const Term& term : Node::of(d)->terms) {
    for (const AtomPtr& atom : term.atoms) {
      if (atom->divisor == 0) {
        names.push_back(atom->name);
      } else {
        collect_symbols(atom->inner, names);
      }
    }
  }
}

}  // namespace

std::vector<std::string> Dim::symbols() const {
  std::vector<std::string> names;
  collect_symbols(*this, names);
  std::ranges::sort(names);
  names.erase(std::unique(names.begin(), names.end()), names.end());
  return names;
}

std::optional<std::string> Dim::beyond_int(const SymbolValues& values) const {
  const std::optional<int64_t> value = evaluate(values);
  if (value && *value == static_cast<int32_t>(*value)) return std::nullopt;
  return "'" + str() + "' is " + (value ? std::to_string(*value) : "beyond 64 bits") +
         ", and an int has 32 bits: compute with floats, as in float(W) * float(W)";
}

std::optional<int64_t> Dim::evaluate(const SymbolValues& values) const {
  if (!node_) return constant_;
  if (is_undefined(*this)) return std::nullopt;
  int64_t sum = 0;
  for (const Term& term : node_->terms) {
    int64_t product = term.coefficient;
    for (const AtomPtr& atom : term.atoms) {
      int64_t factor = 0;
      if (atom->divisor == 0) {
        const auto found = values.find(atom->name);
        if (found == values.end()) return std::nullopt;
        factor = found->second;
      } else {
        const auto inner = atom->inner.evaluate(values);
        if (!inner) return std::nullopt;
        factor = floor_div(*inner, atom->divisor);
      }
      if (mul_overflows(product, factor, &product)) return std::nullopt;
    }
    if (add_overflows(sum, product, &sum)) return std::nullopt;
  }
  return sum;
}

Dim most_of(const Dim& dim) {
  if (dim.is_constant()) return Dim(std::max<int64_t>(dim.constant(), 0));
  if (is_undefined(dim)) return dim;
  // No atom is negative, see above.
  std::vector<Term> terms;
  for (const Term& term : Node::of(dim)->terms)
    if (term.coefficient > 0) terms.push_back(term);
  return from_sorted(std::move(terms));
}

namespace {

// `dim` with `replaced(atom)` in the place of each of its atoms; the undefined extent stays undefined.
template <typename Replaced>
Dim with_atoms(const Dim& dim, const Replaced& replaced) {
  if (dim.is_constant() || is_undefined(dim)) return dim;
  Dim sum(0);
  for (const Term& term : Node::of(dim)->terms) {
    Dim product(term.coefficient);
    for (const AtomPtr& atom : term.atoms) product = product * replaced(atom);
    sum = sum + product;
  }
  return sum;
}

}  // namespace

Dim Dim::substitute(const std::map<std::string, Dim, std::less<>>& replacements) const {
  return with_atoms(*this, [&](const AtomPtr& atom) {
    if (atom->divisor != 0) return atom->inner.substitute(replacements).divided_by(atom->divisor);
    const auto found = replacements.find(atom->name);
    return found != replacements.end() ? found->second : alone(atom);
  });
}

Dim Dim::with_wide_divisions(const std::function<std::string(const Dim& division)>& named) const {
  return with_atoms(*this, [&](const AtomPtr& atom) {
    if (atom->divisor == 0) return alone(atom);
    const bool wide = std::ranges::any_of(Node::of(atom->inner)->terms, [](const Term& inner) {
      return inner.atoms.size() > 1 || (!inner.atoms.empty() && inner.coefficient > 1);
    });
    if (wide) return symbol(named(alone(atom)));
    return atom->inner.with_wide_divisions(named).divided_by(atom->divisor);
  });
}

std::strong_ordering operator<=>(const Dim& a, const Dim& b) {
  if (a.node_ == b.node_) return a.constant_ <=> b.constant_;
  if (a.node_ == nullptr || b.node_ == nullptr) return (a.node_ != nullptr) <=> (b.node_ != nullptr);
  const auto& x = a.node_->terms;
  const auto& y = b.node_->terms;
  if (auto c = x.size() <=> y.size(); std::is_neq(c)) return c;
  for (size_t i = 0; i < x.size(); ++i) {
    if (auto c = compare(x[i].atoms, y[i].atoms); std::is_neq(c)) return c;
    if (auto c = x[i].coefficient <=> y[i].coefficient; std::is_neq(c)) return c;
  }
  return std::strong_ordering::equal;
}

std::optional<Extent> broadcast(const Extent& a, const Extent& b) {
  if (a == b) return a;
  const auto fits = [](const Dim& x, const Dim& y) { return x.is_one() || y.is_one() || x == y; };
  if (!fits(a.w, b.w) || !fits(a.h, b.h) || !fits(a.l, b.l)) return std::nullopt;
  const auto axis = [](const Dim& x, const Dim& y) { return x.is_one() ? y : x; };
  return Extent{axis(a.w, b.w), axis(a.h, b.h), axis(a.l, b.l)};
}

namespace {

// The largest value for symbols of at least 1: nothing where it may grow with them.
std::optional<int64_t> largest_of(const Dim& dim) {
  // If all terms but the constant one are negative, it is largest where the symbols are least.
  if (!most_of(dim).is_constant()) return std::nullopt;
  SymbolValues ones;
  for (const std::string& symbol : dim.symbols()) ones[symbol] = 1;
  return dim.evaluate(ones);
}

}  // namespace

bool never_above_zero(const Dim& dim) {
  const auto largest = largest_of(dim);
  return largest && *largest <= 0;
}

std::optional<int64_t> most_of_quotient(const Dim& dividend, int64_t by) {
  constexpr int64_t kMostScale = int64_t{1} << 20;
  if (is_undefined(dividend)) return std::nullopt;
  // d * floor(p / d) lies between p - (d - 1) and p: times the divisors of all floors there are none left.
  std::vector<Term> storage;
  const std::vector<Term>& terms = terms_of(dividend, storage);
  int64_t scale = 1;
  for (const Term& term : terms)
    for (const AtomPtr& atom : term.atoms)
      if (atom->divisor != 0) {
        if (atom->divisor > kMostScale || scale > kMostScale) return std::nullopt;
        scale = std::lcm(scale, atom->divisor);
      }
  if (scale > kMostScale || by > kMostScale || by <= 0) return std::nullopt;
  Dim sum(0);
  for (const Term& term : terms) {
    const bool rounded = term.atoms.size() == 1 && term.atoms[0]->divisor != 0;
    if (!rounded) {
      sum = sum + from_sorted({term}) * Dim(scale);
      continue;
    }
    const Atom& atom = *term.atoms[0];
    const Dim most = term.coefficient > 0 ? atom.inner : atom.inner - Dim(atom.divisor - 1);
    sum = sum + most * Dim(term.coefficient) * Dim(scale / atom.divisor);
  }
  const auto largest = largest_of(sum);
  return largest ? std::optional(floor_div(*largest, by * scale)) : std::nullopt;
}

}  // namespace dr::ir
