// SPDX-License-Identifier: Apache-2.0
// Which values are zero whatever a host binds: what `known_zero(x)` asks, of constants and of inputs that keep their
// value.
#pragma once

#include <optional>
#include <set>
#include <vector>

#include "compiler/ir/graph.h"

namespace dr::lower {

class Zeros {
 public:
  explicit Zeros(const ir::Graph& graph) : graph_(graph) {}

  // An input of one element that keeps its initial value.
  void fix(uint32_t leaf) { fixed_.insert(leaf); }

  // Whether the value is zero wherever what it is multiplied with is finite.
  bool is_zero(ir::ValueId id);

  // The inputs that answers of `true` rest on.
  const std::set<uint32_t>& used() const { return used_; }
  // Those among them that have to stay open: the program asks for the gradient of a value that such an answer rests on.
  std::set<uint32_t> sought() const;

 private:
  struct Fact {
    std::optional<std::vector<double>> number;  // its components, where they are known
    bool is_zero = false;
    std::vector<ir::ValueId> from;  // the operands by which it is
  };
  Fact fact_of(ir::ValueId id) const;
  std::optional<std::vector<double>> number_of(const ir::Op& op, const ir::Type& type) const;
  bool has_number(ir::ValueId id) const { return facts_[id.index].number.has_value(); }

  const ir::Graph& graph_;
  std::set<uint32_t> fixed_, used_;
  std::vector<Fact> facts_;  // by value, as far as somebody asked
  struct Answer {
    std::set<uint32_t> leaves;
    std::set<ir::ValueId> values;
  };
  std::vector<Answer> answers_;
};

}  // namespace dr::lower
