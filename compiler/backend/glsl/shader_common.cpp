// SPDX-License-Identifier: Apache-2.0
// Regions that have what they compute in common, see analysis/value_numbers.h.
#include <algorithm>

#include "compiler/backend/glsl/shader.h"
#include "compiler/ops/op.h"

namespace dr::backend::glsl {

using ir::Op;
using ir::OpKind;
using ir::ValueId;

namespace {

bool shares_text(const ir::Graph& graph, const std::vector<ir::OpId>& ops) {
  if (std::ranges::any_of(alike_together(graph, ops), [](const Together& t) { return t.ops.size() > 1; })) return true;
  return std::ranges::any_of(ops, [&](ir::OpId id) {
    return std::ranges::any_of(graph.op(id).regions,
                               [&](ir::RegionId inner) { return shares_text(graph, graph.region(inner).ops); });
  });
}

}  // namespace

void Shader::begin_sharing(const std::vector<ir::OpId>& ops, std::span<const ir::RegionId> regions) {
  // Values of a loop are others in each trip.
  const auto is_plain = [&](const std::vector<ir::OpId>& of) {
    return are_plain(graph_, of) && !shares_text(graph_, of);
  };
  if (cut_ || !is_plain(ops) ||
      !std::ranges::all_of(regions, [&](ir::RegionId r) { return is_plain(graph_.region(r).ops); }))
    return;
  common_.emplace(ValueNumbers(graph_,
                               [this](const Op& op) {
                                 if (op.kind != OpKind::Div) return 0;
                                 return (is_hidden(op.operands[1]) ? 2 : 0) + (divides_as_is(op.operands[1]) ? 1 : 0);
                               }),
                  std::vector<std::map<uint32_t, std::string>>(scopes_.size()), nullptr);
}

void Shader::compute_ahead(std::span<const ir::RegionId> regions) {
  if (!common_) return;
  // Constants may stand outside of the regions.
  const auto is_constant = [&](ValueId v) {
    const ir::OpId by = graph_.value(v).op;
    return by.valid() && graph_.op(by).kind == OpKind::Const;
  };
  for (const ir::RegionId region : regions)
    for (const ir::OpId id : graph_.region(region).ops) {
      const Op& op = graph_.op(id);
      const bool plain = op.regions.empty() && (op.kind == OpKind::Const || ops::info(op.kind).glsl != nullptr);
      if (plain && std::ranges::all_of(op.operands, [&](ValueId v) { return is_known(v) || is_constant(v); })) {
        for (const ValueId v : op.operands)
          if (const std::string* name = is_defined(v) ? nullptr : known(v))
            define(v, std::string(*name));
          else if (!is_defined(v))
            this->op(graph_.op(graph_.value(v).op));
        this->op(op);
      }
      compute_ahead(op.regions);
    }
}

void Shader::know(ValueId value, const std::string& expression) {
  if (!graph_.value(value).op.valid()) common_->numbers.add(value, expression);
  common_->known.back().emplace(common_->numbers.of(value), expression);
}

const std::string* Shader::known(ValueId value) {
  if (!common_->numbers.has(value)) return nullptr;
  const uint32_t number = common_->numbers.of(value);
  for (auto scope = common_->known.rbegin(); scope != common_->known.rend(); ++scope)
    if (const auto it = scope->find(number); it != scope->end()) return &it->second;
  return nullptr;
}

// Whether an op has been written, but for results that nobody needs; or writes those that it is needed for.
bool Shader::common_op(const Op& op) {
  common_->numbers.add(op);
  std::vector<size_t> left;
  for (size_t k = 0; k < op.results.size(); ++k) {
    if (common_->needed != nullptr && !common_->needed->contains(op.results[k])) continue;
    if (const std::string* name = known(op.results[k]))
      define(op.results[k], std::string(*name));
    else
      left.push_back(k);
  }
  if (left.empty()) return true;
  if (op.kind != OpKind::If) return false;
  const std::string condition = use(op.operands[0]);
  std::vector<std::string> names;
  for (const size_t k : left) {
    const ir::ValueInfo& info = graph_.value(op.results[k]);
    names.push_back(unique(info.name.empty() ? "if" : info.name));
    body_.line(info.type.str() + " " + names.back() + ";");
  }
  const std::set<ValueId>* const outer = common_->needed;
  for (size_t branch = 0; branch < 2; ++branch) {
    const ir::Region& region = graph_.region(op.regions[branch]);
    std::set<ValueId> yields;
    for (const size_t k : left) yields.insert(region.yields[k]);
    const std::set<ValueId> needed = needed_for(graph_, op.regions[branch], yields);
    common_->needed = &needed;
    if (branch == 0)
      body_.line("if (" + condition + ") {");
    else
      otherwise(condition);
    push_scope();
    for (const ir::OpId id : region.ops) this->op(graph_.op(id));
    for (size_t k = 0; k < left.size(); ++k) body_.line(names[k] + " = " + use(region.yields[left[k]]) + ";");
    pop_scope();
  }
  body_.line("}");
  common_->needed = outer;
  for (size_t k = 0; k < left.size(); ++k) define(op.results[left[k]], names[k]);
  return true;
}

void Shader::leave_unless(ir::RegionId id, const std::string& otherwise, std::optional<ValueId> holds) {
  const ir::Region* region = &graph_.region(id);
  while (common_) {
    if (region->ops.empty()) break;
    const Op& last = graph_.op(region->ops.back());
    const bool chooses = last.kind == OpKind::If && last.results.size() == 1 && last.results[0] == region->yields[0];
    if (!chooses) break;
    const ValueId if_not = graph_.region(last.regions[1]).yields[0];
    const ir::OpId by = graph_.value(if_not).op;
    if (!by.valid() || graph_.op(by).kind != OpKind::Const || graph_.op(by).attrs.floats[0] != 0) break;
    const ir::Region& then = graph_.region(last.regions[0]);
    const bool told = holds == last.operands[0];
    std::set<ValueId> needed;
    if (told) needed = needed_for(graph_, id, needed_for(graph_, last.regions[0], {then.yields[0]}));
    for (size_t k = 0; k + 1 < region->ops.size(); ++k) {
      const Op& one = graph_.op(region->ops[k]);
      if (!told || std::ranges::any_of(one.results, [&](ValueId v) { return needed.contains(v); })) op(one);
    }
    if (!told) body_.line("if (!" + use(last.operands[0]) + ") " + otherwise + ";");
    id = last.regions[0];
    region = &then;
  }
  element_ops(region->ops);
  body_.line("if (!" + use(region->yields[0]) + ") " + otherwise + ";");
}

}  // namespace dr::backend::glsl
