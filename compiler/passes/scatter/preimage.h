// SPDX-License-Identifier: Apache-2.0
// Integers that are made of a variable in a way that can be undone: where `f(x, others) = q`, what is x? An index that
// is clamped, mirrored or wrapped has ranges for an answer.
//   x + 2  ->  q - 2        clamp(x + 2, 0, 9)  ->  q - 2, but ..q - 2 for q = 0 and q - 2.. for q = 9
#pragma once

#include <algorithm>
#include <optional>
#include <utility>
#include <vector>

#include "compiler/passes/scatter/at_places.h"

namespace dr::passes {

// The range of a variable, by values of the graph under construction.
struct Trips {
  ir::ValueId begin, end;
  // The first trip at least and the last one at most, where that is known.
  std::optional<ir::Dim> first, last;
  // How many there are; -1: not known.
  int64_t count() const {
    if (!first || !last || !(*last - *first).is_constant()) return -1;
    return std::max<int64_t>((*last - *first).constant() + 1, 0);
  }
};

// Values of the variable, first to last, both included. A range may be open at either end: it begins at no value and
// ends at `below` at most, or begins at `above` at least.
struct Interval {
  ir::ValueId first, last;  // the same value for a single one
  ir::ValueId when;         // a Bool, or invalid: always
  ir::ValueId modulo;       // the values are those that differ by multiples of this, or invalid
  int64_t width = 1;        // that many values where it is not open
  bool opens_below = false, opens_above = false;
  std::optional<ir::Dim> below, above;
  bool is_single() const { return first == last; }
};

class Preimage {
 public:
  Preimage(const ir::Graph& from, ir::Builder& to, AtPlaces& places, const std::vector<Trips>& variables)
      : from_(from), to_(to), places_(places), variables_(variables) {}

  // Whether component `c` of `v` can be undone; enters what else it is made of into `others`.
  bool exists(ir::ValueId v, int c, Variable variable, Variables& others);
  // Where the component has the value `q`. All of `others` are set.
  std::vector<Interval> of(ir::ValueId v, int c, Variable variable, ir::ValueId q);
  // No more trips than this for one q; -1: not known.
  int64_t bound(const Interval& interval, Variable variable) const;

 private:
  using Part = std::pair<ir::ValueId, int>;  // a component of a value
  struct Range {
    std::optional<ir::Dim> least, most;
  };
  Range range(ir::ValueId v, int c);
  std::optional<int64_t> constant(ir::ValueId v, int c) const;
  const ir::Op* maker(ir::ValueId v) const;
  // The operand of an op that depends on the variable; none where several do.
  std::optional<size_t> path(const ir::Op& op, int c, Variable variable);
  bool exists(ir::ValueId v, int c, Variable variable, Variables& others, bool single);
  bool shifts(ir::ValueId v, int c, Variable variable);
  bool wraps_once(const ir::Op& op, int c, Variable variable);

  void undo(ir::ValueId v, int c, Variable variable, const Interval& interval, std::vector<Interval>& out);
  Interval moved(Interval interval, ir::ValueId v, int c, bool back);
  Interval mirrored(const Interval& interval);
  bool holds(const Part& v, const Part& limit, bool below);
  Interval held(Interval interval, const Part& v, const Part& limit, bool below);
  Interval scaled(Interval interval, int64_t factor);
  Interval divided(Interval interval, int64_t factor);
  Interval positive(Interval interval, int64_t least);

  ir::ValueId number(int64_t x);
  ir::ValueId apply(ir::OpKind kind, ir::ValueId a, ir::ValueId b);
  ir::ValueId both(ir::ValueId a, ir::ValueId b);

  const ir::Graph& from_;
  ir::Builder& to_;
  AtPlaces& places_;
  const std::vector<Trips>& variables_;
};

}  // namespace dr::passes
