// SPDX-License-Identifier: Apache-2.0
// Values of a graph computed anew at other places: the element of a domain and the trips of loops, which the graph has
// from where it runs, become values that are given (*variables*). What invert_scatters.cpp makes gathers with.
#pragma once

#include <array>
#include <map>
#include <optional>
#include <set>
#include <span>
#include <utility>
#include <vector>

#include "compiler/ir/graph.h"

namespace dr::passes {

// An axis of the domain, 0 to 2, or 3 + the running number of a loop.
using Variable = int;
using Variables = uint32_t;  // a set, by bits
inline Variables only(Variable v) { return Variables{1} << v; }

class AtPlaces {
 public:
  // `map` holds the values of the root region in `to`.
  AtPlaces(const ir::Graph& from, ir::Builder& to, const ir::ValueMap& map)
      : from_(from), to_(to), map_(map), scopes_(1) {}

  // The domain of the regions that are made.
  void run_over(const ir::Extent& domain) { domain_ = domain; }
  // What a variable is from now on, until the scope is left.
  void set(Variable variable, ir::ValueId now) { scopes_.back().variables[variable] = now; }
  // The trip parameters of loops are variables.
  void declare(ir::ValueId trip, Variable variable) { trips_[trip] = variable; }
  void enter() { scopes_.emplace_back(); }
  void leave() { scopes_.pop_back(); }

  // What a value, or an integer's component `c`, depends on.
  Variables depends(ir::ValueId v);
  Variables depends(ir::ValueId v, int c);
  // The variable that a value is; none where it is computed.
  std::optional<Variable> variable(ir::ValueId v) const;
  // The operands of an op that make its component `c`, each with its own.
  std::vector<std::pair<ir::ValueId, int>> parts(const ir::Op& op, int c) const;

  // The value in the builder. All variables that it depends on are set.
  ir::ValueId at(ir::ValueId v);
  ir::ValueId at(ir::ValueId v, int c);
  // Computes what `v` is made of as far as the variables in `known` allow, so that inner regions find it.
  void prepare(ir::ValueId v, Variables known);

 private:
  struct Scope {
    std::map<ir::ValueId, ir::ValueId> values;
    std::map<Variable, ir::ValueId> variables;
  };

  bool is_root(ir::ValueId v) const { return from_.value(v).region == from_.root(); }
  const ir::Op* maker(ir::ValueId v) const;
  std::vector<ir::ValueId> asked_for(const ir::Op& op, ir::RegionId region) const;
  bool is_computed(ir::ValueId v);
  bool is_pure(ir::ValueId v);
  bool is_cheap(ir::ValueId v, int depth, std::set<ir::ValueId>& loads);
  ir::ValueId now(Variable variable) const;
  ir::ValueId place(const ir::Extent& extent);
  bool reads_own_layer(const ir::Op& gather) const;
  ir::ValueId gather(const ir::Op& op);
  ir::ValueId compute(ir::ValueId v);
  ir::RegionId region(const ir::Op& op, ir::RegionId id);

  const ir::Graph& from_;
  ir::Builder& to_;
  const ir::ValueMap& map_;
  ir::Extent domain_;
  std::vector<Scope> scopes_;
  std::map<ir::ValueId, Variable> trips_;
  std::map<std::pair<ir::ValueId, int>, Variables> depends_;
  std::map<ir::ValueId, bool> pure_, computed_;
};

}  // namespace dr::passes
