// SPDX-License-Identifier: Apache-2.0
// Map passes whose invocations compute several elements, one after the other. Where a shader's lanes access memory in
// turn, as on a processor, what an invocation does before its elements and after them costs as much as an element:
// constants of the pass are computed once, and one store tells of NaN in all elements. A workgroup has
// elements that follow each other, and so have its lanes: memory is read once, in order. Where most elements of an
// update rest (lowering/leave_at_rest.h), an invocation has a word of 32 bits, and goes from one bit to the next.
#include <algorithm>
#include <set>

#include "compiler/backend/emit/generator.h"

namespace dr::backend {

using glsl::Shader;
using ir::Op;
using ir::OpId;
using ir::OpKind;
using ir::ValueId;

namespace {

// Invocations of a workgroup that goes by bits: so few that all processors have some.
constexpr int kGroupByBits = 16;

// Ops of a pass by how often an invocation computes them.
struct Shares {
  std::vector<OpId> once, each;
  std::vector<ValueId> read_once;  // by those of each element
};

Shares share(const ir::Graph& graph, const Pass& pass) {
  Shares out;
  std::set<ValueId> each;  // results
  for (const OpId id : pass.ops) {
    const Op& op = graph.op(id);
    const auto same = [&](ValueId v) { return graph.value(v).extent.is_unit() && each.count(v) == 0; };
    if (op.regions.empty() && std::ranges::all_of(op.operands, same) && std::ranges::all_of(op.results, same)) {
      out.once.push_back(id);
      continue;
    }
    out.each.push_back(id);
    each.insert(op.results.begin(), op.results.end());
    if (!op.regions.empty() || op.kind == OpKind::Gather || op.kind == OpKind::Shift) continue;
    std::ranges::copy_if(op.operands, std::back_inserter(out.read_once), same);
  }
  return out;
}

}  // namespace

void Generator::strided_map_pass(const Pass& pass) {
  const MapCode& code = pass.get<MapPass>().code;
  const ir::Dim count = element_count(pass.domain);
  const Shares shares = share(graph_, pass);
  const bool by_bits = pass.get<MapPass>().rest.has_value();
  const std::string run = std::to_string(kListedRun), count_text = glsl::dim_expression(count);
  const ir::Dim words = runs_of(count);
  Shader s = shader();
  linear_index(s, by_bits ? glsl::dim_expression(words) : "");
  if (!by_bits) {
    s.body().line("int group = int(gl_WorkGroupSize.x), local = int(gl_LocalInvocationID.x);");
    s.body().line("int groups = int(gl_NumWorkGroups.x * gl_NumWorkGroups.y);");
    s.body().line("int part = ((" + count_text +
                  " - 1) / (group * groups) + 1) * group, begin = index / group * part;");
    s.body().line("int end = min(begin + part, " + count_text + ");");
  }
  s.body().line("const ivec3 at = ivec3(0);");
  s.element_ops(shares.once);
  for (const ValueId v : shares.read_once) s.use(v);
  const bool tells = !code.told.empty();
  if (tells) s.body().line("uint largest = 0u;");
  if (by_bits) {
    const std::string marks = s.read_words(stepped_lists_.at(&pass), "marked");
    s.body().line("uint marked_elements = " + marks + "(" + std::to_string(kListHead) + " + index);");
    s.body().line("for (; marked_elements != 0u; marked_elements &= marked_elements - 1u) {");
  } else {
    s.body().line("for (int element = begin + local; element < end; element += group) {");
  }
  s.push_scope();
  if (by_bits) s.body().line("int element = index * " + run + " + findLSB(marked_elements);");
  place_from_index(s, pass.domain, "element");
  take_sums(s, pass);
  s.element_ops(shares.each);
  for (const ValueId v : pass.writes) store_changed(s, pass, v);
  if (tells) s.body().line("largest = max(largest, " + largest_bits(s, code.told) + ");");
  s.pop_scope();
  s.body().line("}");
  if (tells) tell_not_finite(s, pass, "largest");
  if (by_bits)
    dispatch(pass, "", s, words.str(), {0, 0, 0}, kGroupByBits);
  else
    dispatch(pass, "", s, count.str()).each = static_cast<uint32_t>(code.each);
}

}  // namespace dr::backend
