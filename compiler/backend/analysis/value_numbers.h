// SPDX-License-Identifier: Apache-2.0
// Numbers of values: two with one number are the same, whatever ops compute them. So the closures of a raster find what
// another one has computed. A result of an `if` is what its condition chooses between, whichever other results it has:
//   (d, f) = if c { (x, 1) } else { (y, 2) }     e = if c { x } else { y }     d and e have one number
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "compiler/ir/graph.h"

namespace dr::backend {

class ValueNumbers {
 public:
  // `form`: what else tells two ops of a kind apart.
  ValueNumbers(const ir::Graph& graph, std::function<int(const ir::Op&)> form)
      : graph_(graph), form_(std::move(form)) {}

  // The results of an op, and what its regions compute. Its operands come first; those that did not have numbers of
  // their own.
  void add(const ir::Op& op);
  // A parameter of a region; those of one name are the same.
  void add(ir::ValueId param, const std::string& name) { numbers_[param] = number_of("param " + name); }
  uint32_t of(ir::ValueId value);
  bool has(ir::ValueId value) const { return numbers_.contains(value); }

 private:
  uint32_t number_of(const std::string& key) {
    return by_key_.emplace(key, static_cast<uint32_t>(by_key_.size())).first->second;
  }

  const ir::Graph& graph_;
  std::function<int(const ir::Op&)> form_;
  std::map<std::string, uint32_t> by_key_;
  std::map<ir::ValueId, uint32_t> numbers_;
};

// Whether ops have no side effects and no loops.
bool are_plain(const ir::Graph& graph, const std::vector<ir::OpId>& ops);

// The values of a plain region, and of those inside of it, that some of its yields need.
std::set<ir::ValueId> needed_for(const ir::Graph& graph, ir::RegionId region, const std::set<ir::ValueId>& yields);

}  // namespace dr::backend
