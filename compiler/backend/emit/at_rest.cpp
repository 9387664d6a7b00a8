// SPDX-License-Identifier: Apache-2.0
// Updates that leave elements at rest out (lowering/leave_at_rest.h): what lists the others, in the prologue, and the
// update itself, which runs for the list. So does what sums their gradients (rows.cpp).
#include "compiler/backend/emit/generator.h"
#include "compiler/backend/schedule/rest.h"

namespace dr::backend {

using glsl::Shader;
using ir::ValueId;

void Generator::list_stepped(const Pass& gradient, const Pass& update, uint32_t starts) {
  const AtRest& rest = *update.get<MapPass>().rest;
  const RestFacts facts = facts_at_rest(graph_, *step_, update, rest);
  const uint32_t list = add_list(update, "stepped", bundle::ListKind::Stepped);
  // Elements that are not listed stay as they are, and those that are stay on the list, whatever the step does.
  out_->commands.back()->foresees = true;
  stepped_lists_[&update] = list;
  Shader s = shader();
  ListingLoop loop(s, update.domain, rest.lists_in_runs);
  const std::string element = loop.element();
  std::string moves = "false";
  if (starts != 0) {
    const std::string start = s.read_words(starts, "starts", "int");
    moves = start + "(" + element + ") != " + start + "(" + element + " + 1)";
  }
  Clauses memory;
  for (const ValueId v : rest.memory) memory.push_back({v});
  if (!memory.empty()) moves += " || " + active_condition(s, memory);
  for (const ValueId v : facts.zero) s.define(v, glsl::zero(graph_.value(v).type));
  for (const ir::OpId id : ops_at_rest(graph_, update, facts)) {
    const ValueId result = graph_.op(id).results[0];
    if (const auto chosen = facts.chosen.find(result); chosen != facts.chosen.end())
      s.define(result, s.use(chosen->second));
    else
      s.element_ops({id});
  }
  // A NaN is another number than itself: it does not rest, so that the update still tells of it.
  for (const ValueId v : update.writes) {
    const ResourceId id = step_->stored.at(v);
    if (facts.zero.count(v) != 0) continue;
    for (const ValueId old : update.reads) {
      if (step_->stored.at(old) != id) continue;
      const std::string a = s.use(v), b = s.load(old, s.at());
      moves += " || " + (graph_.value(v).type.is_scalar() ? a + " != " + b : "any(notEqual(" + a + ", " + b + "))");
    }
  }
  const std::string words = s.bind_words(list, "stepped_elements", bundle::Access::ReadWrite);
  s.body().line("bool moves = " + moves + ";");
  if (starts == 0) {
    const uint32_t woken = woken_[&update] = add_scratch(update.name + "_woken", element_count(update.domain).str());
    const std::string marks = s.bind_words(woken, "woken_elements", bundle::Access::Write);
    s.body().line(marks + ".d[" + element + "] = moves ? 1u : 0u;");
  }
  s.body().line("if (moves) {");
  loop.add(words);
  s.body().line("}");
  const std::string invocations = loop.close();
  dispatch(gradient, "_stepped", s, invocations).foresees = true;
}

std::string Generator::wake(Shader& s, const Target& t, const std::string& added) {
  const std::string id = t.accumulator.name;
  const std::string list = s.bind_words(t.list, "stepped_elements_" + id, bundle::Access::ReadWrite);
  const std::string marks = s.bind_words(t.woken, "woken_elements_" + id, bundle::Access::ReadWrite);
  return "  if ((" + added + ") != 0u && " + marks + ".d[element] == 0u && atomicExchange(" + marks +
         ".d[element], 1u) == 0u) " + append(s, list, "element") + ";\n";
}

std::string Generator::stepped_index(Shader& s, uint32_t list) {
  const std::string words = s.read_words(list, "stepped_elements");
  linear_index(s, "int(" + words + "(" + std::to_string(kListEnd) + ")) - 1");
  return "int(" + words + "(" + std::to_string(kListHead) + " + index))";
}

void Generator::stepped_map_pass(const Pass& pass) {
  const uint32_t list = stepped_lists_.at(&pass);
  Shader s = shader();
  s.body().line("int element = " + stepped_index(s, list) + ";");
  place_from_index(s, pass.domain, "element");
  take_sums(s, pass);
  s.element_ops(pass.ops);
  store_results(s, pass);
  dispatch(pass, "", s, element_count(pass.domain).str()).indirect = static_cast<int>(list);
}

}  // namespace dr::backend
