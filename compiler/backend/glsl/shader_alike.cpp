// SPDX-License-Identifier: Apache-2.0
// Branches that share a text, see analysis/alike_branches.h: a loop over those that an element takes.
#include <algorithm>

#include "compiler/backend/glsl/shader.h"
#include "compiler/ir/yields.h"

namespace dr::backend::glsl {

using ir::Op;
using ir::ValueId;
using ir::Yield;

// Whether all of them are printed whole, and add to the same sums.
bool Shader::may_loop(const Together& together) const {
  constexpr size_t kMost = 32;  // a bit each
  const Op& first = graph_.op(together.ops[0]);
  return together.ops.size() <= kMost && std::ranges::all_of(together.ops, [&](ir::OpId id) {
           const Op& op = graph_.op(id);
           if (!op.results.empty() && left_out_.count(op.results[0]) != 0) return false;
           for (size_t k = 0; k < op.results.size(); ++k) {
             const auto one = accumulators_.find(first.results[k]), other = accumulators_.find(op.results[k]);
             if ((one == accumulators_.end()) != (other == accumulators_.end())) return false;
             if (one != accumulators_.end() && one->second.name != other->second.name) return false;
           }
           return true;
         });
}

// One of several expressions, by a number.
std::string Shader::choice(const std::string& which, const std::vector<std::string>& values) const {
  std::string out;
  for (size_t k = 0; k + 1 < values.size(); ++k) out += which + " == " + std::to_string(k) + " ? " + values[k] + " : ";
  return "(" + out + values.back() + ")";
}

void Shader::alike_ops(const Together& together) {
  const Op& first = graph_.op(together.ops[0]);
  const size_t results = first.results.size();
  std::vector<std::vector<std::string>> taken, names(together.ops.size());
  for (const std::vector<ValueId>& values : together.taken)
    for (taken.emplace_back(); const ValueId v : values) taken.back().push_back(use(v));
  std::string conditions;
  for (size_t b = 0; b < together.ops.size(); ++b)
    conditions += (b > 0 ? " | " : "") + ("(" + use(graph_.op(together.ops[b]).operands[0])) + " ? " +
                  std::to_string(1u << b) + "u : 0u)";
  // What stands for a branch that is not taken.
  for (size_t b = 0; b < together.ops.size(); ++b) {
    const Op& op = graph_.op(together.ops[b]);
    push_scope();
    for (const ir::OpId id : graph_.region(op.regions[1]).ops) this->op(graph_.op(id));
    const std::vector<ir::Yielded> parts = ir::yielded(graph_, op, op.regions[1]);
    for (size_t k = 0; k < results; ++k) {
      const ir::ValueInfo& info = graph_.value(op.results[k]);
      const bool adds = op.attrs.yields[k] == Yield::Scatter;
      names[b].push_back(adds ? std::string() : unique(info.name.empty() ? "if" : info.name));
      if (!adds) body_.line(info.type.str() + " " + names[b][k] + " = " + use(parts[k].value) + ";");
    }
    pop_scope();
  }

  const std::string left = unique("left"), which = unique("which");
  body_.line("for (uint " + left + " = " + conditions + "; " + left + " != 0u; " + left + " &= " + left + " - 1u) {");
  push_scope();
  body_.line("int " + which + " = findLSB(" + left + ");");
  for (size_t k = 0; k < taken.size(); ++k) {
    const ir::Type& type = graph_.value(together.taken[k][0]).type;
    const std::string name = unique("taken");
    body_.line(type.str() + " " + name + " = " + choice(which, taken[k]) + ";");
    define(together.taken[k][0], name);
  }
  std::vector<std::string> own;
  for (size_t k = 0; k < results; ++k) {
    own.push_back(names[0][k].empty() ? std::string() : unique("own"));
    if (!own[k].empty()) body_.line(graph_.value(first.results[k]).type.str() + " " + own[k] + ";");
    const auto sum = accumulators_.find(first.results[k]);
    if (sum == accumulators_.end() || sum->second.site.empty()) continue;
    std::vector<std::string> sites;
    for (const ir::OpId id : together.ops) sites.push_back(accumulators_.at(graph_.op(id).results[k]).site);
    sum->second.site = choice(which, sites);
  }
  forward_accumulators(first, first.regions[0]);
  yields(first, first.regions[0], own, {});
  for (size_t k = 0; k < results; ++k)
    for (size_t b = 0; b < names.size() && !own[k].empty(); ++b)
      body_.line("if (" + which + " == " + std::to_string(b) + ") " + names[b][k] + " = " + own[k] + ";");
  pop_scope();
  body_.line("}");
  for (size_t b = 0; b < together.ops.size(); ++b)
    for (size_t k = 0; k < results; ++k)
      if (!names[b][k].empty()) define(graph_.op(together.ops[b]).results[k], names[b][k]);
}

}  // namespace dr::backend::glsl
