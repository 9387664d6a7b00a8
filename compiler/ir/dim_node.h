// SPDX-License-Identifier: Apache-2.0
// What an extent is made of, private to dim*.cpp.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "compiler/ir/dim.h"

namespace dr::ir {

struct Atom;
using AtomPtr = std::shared_ptr<const Atom>;

// coefficient * product of atoms. The atoms are sorted, with repeats.
struct Term {
  std::vector<AtomPtr> atoms;
  int64_t coefficient = 0;
};
bool operator==(const Term& a, const Term& b);

// A polynomial that is not a constant, or the undefined extent (no terms): the result of arithmetic that does not fit.
struct Dim::Node {
  std::vector<Term> terms;  // sorted by atoms, no zero coefficients; the constant term has no atoms and is last
  size_t weight = 0;
  uint64_t hash = 0;

  static const Node* of(const Dim& d) { return d.node_; }
  // The one extent with these terms, which are sorted and collected; none are the undefined extent.
  static Dim intern(Node node);
  static Dim undefined() { return Dim::undefined(); }
};

// A symbol, or floor(inner / divisor).
struct Atom {
  std::string name;     // of a symbol
  Dim inner;            // of a division
  int64_t divisor = 0;  // 0: a symbol
  size_t weight = 1;
  uint64_t hash = 0;
};

}  // namespace dr::ir
