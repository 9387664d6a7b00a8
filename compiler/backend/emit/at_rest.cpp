// SPDX-License-Identifier: Apache-2.0
// Updates that leave elements at rest out (lowering/leave_at_rest.h): what lists the others, in the prologue, and the
// update itself, which runs for the list. So does what sums their gradients (rows.cpp). Or blocks that hold others are
// marked, a word each behind the head of a list without elements: an invocation of the update ends where there is none.
#include <algorithm>

#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/emit/generator.h"
#include "compiler/backend/schedule/rest.h"

namespace dr::backend {

using glsl::dim_expression;
using glsl::Shader;
using ir::ValueId;

namespace {

// That a workgroup of an update takes.
constexpr int kBlocksEach = 8;

// Blocks of an update, in full groups of kBlocksEach.
ir::Dim blocks_of(const Pass& update) {
  constexpr int kAll = kRestingBlock * kBlocksEach;
  return (element_count(update.domain) + ir::Dim(kAll - 1)).divided_by(kAll) * ir::Dim(kBlocksEach);
}

// Whether the bits of some component compare so with a word.
std::string with_bits(const std::string& value, const ir::Type& type, const char* function, const char* sign,
                      const std::string& word) {
  const std::string bits = "floatBitsToUint(" + value + ")";
  if (type.is_scalar()) return bits + " " + sign + " " + word;
  return "any(" + std::string(function) + "(" + bits + ", uvec" + std::to_string(type.components()) + "(" + word +
         ")))";
}

}  // namespace

// Whether a float has bits that +0 has not.
std::string Generator::has_bits(Shader& s, ValueId v) const {
  return with_bits(s.use(v), graph_.value(v).type, "notEqual", "!=", "0u");
}

void Generator::list_stepped(const Pass& gradient, const Pass& update, uint32_t starts) {
  const AtRest& rest = *update.get<MapPass>().rest;
  const RestFacts facts = facts_at_rest(graph_, *step_, update, rest);
  const uint32_t list = rest.is_marked() ? add_marks(update) : add_list(update, "stepped", bundle::ListKind::Stepped);
  // Elements that are not listed stay as they are, and those that are stay on the list, whatever the step does.
  out_->commands.back()->foresees = true;
  stepped_lists_[&update] = list;
  Shader s = shader();
  ListingLoop loop(s, update.domain, rest.lists_in_runs || rest.in_bits);
  const std::string element = loop.element();
  std::string moves = "false";
  if (starts != 0) {
    const std::string start = s.read_words(starts, "starts", "int");
    moves = start + "(" + element + ") != " + start + "(" + element + " + 1)";
  }
  for (const ValueId v : rest.memory) moves += " || " + has_bits(s, v);
  for (const ValueId v : facts.zero) s.define(v, s.hidden_zero(graph_.value(v).type));
  for (const ir::OpId id : ops_at_rest(graph_, update, facts)) {
    const ValueId result = graph_.op(id).results[0];
    if (const auto chosen = facts.chosen.find(result); chosen != facts.chosen.end())
      s.define(result, s.use(chosen->second));
    else
      s.element_ops({id});
  }
  // A NaN is another number than itself: it does not rest, so that the update still tells of it. Nor does -0, which is
  // 0 once 0 is added, whatever a driver makes of a constant 0 here.
  for (const ValueId v : update.writes) {
    const ResourceId id = step_->stored.at(v);
    const auto is_it = [&](ValueId old) { return step_->stored.at(old) == id; };
    // What is remembered was zero, too.
    if (facts.zero.count(v) != 0 && std::ranges::any_of(rest.memory, is_it)) continue;
    const bool scalar = graph_.value(v).type.is_scalar();
    for (const ValueId old : update.reads) {
      if (!is_it(old)) continue;
      const std::string a = s.use(v), b = s.load(old, s.at());
      moves += " || " + (scalar ? a + " != " + b : "any(notEqual(" + a + ", " + b + "))");
      moves += " || " + with_bits(b, graph_.value(v).type, "equal", "==", "0x80000000u");
    }
  }
  // The reader of the first element leaves what the next run guesses.
  if (gradient.get<ScatterPass>().guesses()) moves += " || " + element + " == 0";
  s.body().line("bool moves = " + moves + ";");
  if (rest.is_marked()) {
    const std::string marks = s.bind_words(list, "marked_" + std::to_string(list), bundle::Access::ReadWrite);
    s.body().line("if (moves) " + mark(s, update, element) + ";");
    // The first word says how many elements there are, the end of a list is one more than it has elements.
    s.body().line("if (" + element + " == 0) {");
    s.body().line(marks + ".d[0] = uint(" + dim_expression(element_count(update.domain)) + ");");
    s.body().line("atomicAdd(" + marks + ".d[" + std::to_string(kListEnd) + "], 1u);");
    s.body().line("}");
    dispatch(gradient, "_stepped", s, loop.close()).foresees = true;
    return;
  }
  const std::string words = s.bind_words(list, "stepped_elements", bundle::Access::ReadWrite);
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

uint32_t Generator::add_marks(const Pass& update) {
  const ir::Dim words = update.get<MapPass>().rest->in_bits ? runs_of(element_count(update.domain)) : blocks_of(update);
  const uint32_t marks = add_scratch(update.name + "_stepped", (words + ir::Dim(kListHead)).str());
  bundle_->resources[marks]->list = bundle::ListKind::Stepped;
  fill("clear " + update.name + " stepped", marks, 0);
  return marks;
}

// The head counts the elements that are marked, or those of marked blocks.
std::string Generator::mark(Shader& s, const Pass& update, const std::string& element) const {
  const bool in_bits = update.get<MapPass>().rest->in_bits;
  const std::string id = std::to_string(stepped_lists_.at(&update)),
                    marks = s.bind_words(stepped_lists_.at(&update), "marked_" + id, bundle::Access::ReadWrite),
                    each = std::to_string(in_bits ? kListedRun : kRestingBlock),
                    count = dim_expression(element_count(update.domain)),
                    end = marks + ".d[" + std::to_string(kListEnd) + "]",
                    word = marks + ".d[" + std::to_string(kListHead) + " + element / " + each + "]";
  s.prelude("void mark_" + id + "(int element) {\n" +
            (in_bits ? "  uint bit = 1u << uint(element % " + each + ");\n  if ((" + word +
                           " & bit) == 0u && (atomicOr(" + word + ", bit) & bit) == 0u) atomicAdd(" + end + ", 1u);\n"
                     : "  if (" + word + " == 0u && atomicExchange(" + word + ", 1u) == 0u)\n    atomicAdd(" + end +
                           ", uint(min(" + each + ", " + count + " - element / " + each + " * " + each + ")));\n") +
            "}\n");
  return "mark_" + id + "(" + element + ")";
}

std::string Generator::wake(Shader& s, const Target& t, const std::string& added) {
  const std::string is_added = "  if ((" + added + ") != 0u";
  if (t.update->get<MapPass>().rest->is_marked()) return is_added + ") " + mark(s, *t.update, "element") + ";\n";
  const std::string id = t.accumulator.name;
  const std::string list =
      s.bind_words(stepped_lists_.at(t.update), "stepped_elements_" + id, bundle::Access::ReadWrite);
  const std::string marks = s.bind_words(woken_.at(t.update), "woken_elements_" + id, bundle::Access::ReadWrite);
  return is_added + " && " + marks + ".d[element] == 0u && atomicExchange(" + marks + ".d[element], 1u) == 0u) " +
         append(s, list, "element", t.update->domain) + ";\n";
}

std::string Generator::stepped_index(Shader& s, uint32_t list) {
  const std::string words = s.read_words(list, "stepped_elements");
  linear_index(s, "int(" + words + "(" + std::to_string(kListEnd) + ")) - 1");
  return "int(" + words + "(" + std::to_string(kListHead) + " + index))";
}

void Generator::stepped_map_pass(const Pass& pass) {
  if (pass.get<MapPass>().rest->in_bits) return strided_map_pass(pass);
  if (pass.get<MapPass>().rest->in_blocks) return marked_map_pass(pass);
  const uint32_t list = stepped_lists_.at(&pass);
  Shader s = shader();
  s.body().line("int element = " + stepped_index(s, list) + ";");
  place_from_index(s, pass.domain, "element");
  take_sums(s, pass);
  s.element_ops(pass.ops);
  store_results(s, pass);
  dispatch(pass, "", s, element_count(pass.domain).str()).indirect = static_cast<int>(list);
}

// Starting a workgroup takes a GPU longer than looking whether it has something to do, and where lanes take each
// other's branches, an update costs the same whether one lane has something to do or all: a workgroup takes several
// blocks, and finds out about them all at once.
void Generator::marked_map_pass(const Pass& pass) {
  const bool looks = !pass.get<MapPass>().rest->gathers.empty();
  const std::string block = std::to_string(kRestingBlock), each = std::to_string(kBlocksEach),
                    count = dim_expression(element_count(pass.domain));
  Shader s = shader();
  s.body().line("int first = int(gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x) * " + each + ";");
  s.body().line("if (first >= " + dim_expression(blocks_of(pass)) + ") return;");
  s.body().line("uint marked = 0u;");
  if (looks) {
    look_at_gathers(s, pass);
  } else {
    const std::string marks = s.read_words(stepped_lists_.at(&pass), "marked_blocks");
    for (int k = 0; k < kBlocksEach; ++k)
      s.body().line("marked |= " + marks + "(" + std::to_string(kListHead + k) + " + first) << " + std::to_string(k) +
                    ";");
  }
  s.body().line("for (; marked != 0u; marked &= marked - 1u) {");
  s.push_scope();
  s.body().line("int element = (first + findLSB(marked)) * " + block + " + int(gl_LocalInvocationID.x);");
  s.body().line("if (element >= " + count + ") return;");
  place_from_index(s, pass.domain, "element");
  take_sums(s, pass);
  s.element_ops(pass.ops);
  store_results(s, pass);
  s.pop_scope();
  s.body().line("}");
  dispatch(pass, "", s, (blocks_of(pass).divided_by(kBlocksEach) * ir::Dim(kRestingBlock)).str(), {0, 0, 0},
           kRestingBlock);
}

// Elements without a mark look whether what they gather moves them, and mark their blocks.
void Generator::look_at_gathers(Shader& s, const Pass& pass) {
  const uint32_t list = stepped_lists_.at(&pass);
  const std::vector<ValueId> gathered = gathered_at_rest(graph_, *pass.get<MapPass>().rest);
  const std::string marks = s.bind_words(list, "marked_" + std::to_string(list), bundle::Access::ReadWrite);
  s.body().line("for (int k = 0; k < " + std::to_string(kBlocksEach) + "; ++k) {");
  s.push_scope();
  s.body().line("int element = (first + k) * " + std::to_string(kRestingBlock) + " + int(gl_LocalInvocationID.x);");
  s.body().line("if (element >= " + dim_expression(element_count(pass.domain)) + ") break;");
  place_from_index(s, pass.domain, "element");
  s.element_ops(ops_of(graph_, pass.ops, gathered));
  std::string moving = "false";
  for (const ValueId v : gathered) moving += " || " + has_bits(s, v);
  s.body().line("bool moves = " + marks + ".d[" + std::to_string(kListHead) + " + first + k] != 0u;");
  s.body().line("if (!moves && (" + moving + ")) {");
  s.body().line(mark(s, pass, "element") + ";");
  s.body().line("moves = true;");
  s.body().line("}");
  s.body().line("if (moves) marked |= 1u << k;");
  s.pop_scope();
  s.body().line("}");
}

}  // namespace dr::backend
