// SPDX-License-Identifier: Apache-2.0
// Exact sums that a map adds to, joined by its workgroups. Each invocation keeps what it adds until it is done with its
// element. Then the workgroup adds it up in tables of its own, by place, as integers, and adds the tables to memory:
// pixels of a square share most of the texels, or vertices, that they add to. Sums with the same places share a table.
// A number there has two limbs, which no carry joins before the end. What a table has no room for, and what limbs do
// not hold, as contributions far above those of the run before, an invocation adds to memory itself.
#include <bit>

#include "compiler/backend/emit/generator.h"
#include "compiler/backend/glsl/fixed_point.h"
#include "compiler/backend/schedule/joined_sums.h"

namespace dr::backend {

using glsl::component;
using glsl::Shader;

namespace {

// Places of the table that are tried for an element.
constexpr int kTries = 3;
// Rows of elements lie so far apart in the table that those of a square of pixels do not meet, nor the words of a
// subgroup's pixels in one bank of the workgroup's memory.
constexpr int kRow = 24;

std::string number(size_t k) { return std::to_string(k); }

// What stands in place `site`, which varies, of an array that is never indexed by it: it would leave the registers.
std::string at_site(const std::string& array, size_t sites) {
  std::string out = array + "[" + number(sites - 1) + "]";
  for (size_t k = sites - 1; k-- > 0;) out = "site == " + number(k) + " ? " + array + "[" + number(k) + "] : " + out;
  return "(" + out + ")";
}

}  // namespace

// All that a workgroup adds to an element is beyond no int.
std::string Generator::limb_bits(const Target& t) {
  const auto most = static_cast<unsigned>(t.group) * std::bit_ceil(static_cast<unsigned>(t.sum.terms.size()));
  return std::to_string(32 - std::bit_width(most)) + "u";
}

void Generator::find_same_places(const std::vector<Target*>& targets) const {
  if (targets.empty()) return;
  std::vector<const ScatterSum*> sums;
  for (const Target* t : targets) sums.push_back(&t->sum);
  for (const JoinedSums& same : joined_sums(graph_, sums, targets[0]->group))
    for (const size_t k : same.sums) targets[k]->places = targets[same.sums[0]]->accumulator.name;
}

std::string Generator::keep_for_group(Shader& s, const Target& t, bool lists) {
  const std::string &id = t.accumulator.name, value = "kept_" + id;
  const ir::Type& type = t.accumulator.type;
  const size_t sites = t.sum.terms.size();
  std::string none, zeros, most, finite;
  for (size_t k = 0; k < sites; ++k) {
    none += (k > 0 ? ", -1" : "-1");
    zeros += (k > 0 ? ", " : "") + glsl::zero(type);
  }
  for (int c = 0; c < type.components(); ++c) {
    const std::string x = component(type, "value", c), bits = "floatBitsToUint(" + x + ") & 0x7fffffffu";
    most = c == 0 ? bits : "max(" + most + ", " + bits + ")";
    finite = c == 0 ? "finite_magnitude(" + x + ")" : "max(" + finite + ", finite_magnitude(" + x + "))";
  }
  const std::string n = number(sites);
  s.prelude(glsl::kFixedLimbs);
  if (t.places == id) s.declare("int kept_element_" + id + "[" + n + "] = int[" + n + "](" + none + ");\n");
  s.declare("uint largest_" + id + " = 0u, without_limbs_" + id + " = 0u, rare_" + id + " = 0u;\n" + type.str() + " " +
            value + "[" + n + "] = " + type.str() + "[" + n + "](" + zeros + ");\n");
  return "  uint most = " + most + ";\n  largest_" + id + " = max(largest_" + id +
         ", most < 0x7f800000u ? most : " + finite + ");\n" + (lists ? "  adds" + t.list + " |= most;\n" : "") +
         "  if (most != 0u) {\n    kept_element_" + t.places + "[site] = element;\n    " + value +
         "[site] = value;\n    if (most >= without_limbs_" + id + ") rare_" + id + " |= 1u << site;\n  }\n";
}

void Generator::join_in_group(Shader& s, const std::vector<const Target*>& targets) {
  const std::string group = std::to_string(targets[0]->group);
  s.declare("shared uint group_adds;\n");
  std::vector<const ScatterSum*> sums;
  for (const Target* t : targets) sums.push_back(&t->sum);
  const std::vector<JoinedSums> joined = joined_sums(graph_, sums, targets[0]->group);
  DR_ASSERT(!joined.empty());
  std::string any, clear, add, rest, flush;
  for (const JoinedSums& same : joined) {
    const Target& first = *targets[same.sums[0]];
    const std::string &places = first.places, keys = "keys_" + places, table = "table_" + places,
                      left = "left_" + places, size = std::to_string(same.elements);
    const size_t sites = first.sum.terms.size();
    const std::string bits = limb_bits(first), width = glsl::dim_expression(first.accumulator.extent.w);
    std::string rare = left, in_table, in_memory;
    int words = 0;
    flush += "  for (uint at = lane; at < " + size + "u; at += " + group + "u) {\n    int element = int(" + keys +
             "[at]) - 1;\n    if (element < 0) continue;\n";
    std::vector<std::string> at_sites(sites);
    for (const size_t k : same.sums) {
      const Target& t = *targets[k];
      const std::string &id = t.accumulator.name, of = number(k);
      const ir::Type& type = t.accumulator.type;
      const std::string buffer = s.bind_words(t.words, "sums_" + id, bundle::Access::ReadWrite, sum_word());
      rare += " | rare_" + id;
      s.declare("void add_to_memory_" + id + "(int element, " + type.str() + " value) {\n" + fixed_parts(s, t) +
                add_parts(s, t, buffer) + "}\n");
      in_memory += "      if (((" + left + " | rare_" + id + ") >> site & 1u) != 0u) add_to_memory_" + id +
                   "(element, " + at_site("kept_" + id, sites) + ");\n";
      std::string limbs, added = "0u";
      flush += "    {\n";
      for (int c = 0; c < type.components(); ++c, words += 2) {
        const std::string low = table + "[at + " + std::to_string(words * same.elements) + "u]",
                          high = table + "[at + " + std::to_string((words + 1) * same.elements) + "u]",
                          part = "part_" + std::to_string(c);
        limbs += "    limbs = limbs_from_float(" + component(type, "value", c) + ", shift_" + id + ", " + bits +
                 ");\n    if (limbs.x != 0) atomicAdd(" + low + ", limbs.x);\n    if (limbs.y != 0) atomicAdd(" + high +
                 ", limbs.y);\n";
        flush += "    uvec2 " + part + " = fixed_of_limbs(ivec2(" + low + ", " + high + "), " + bits + ");\n  " +
                 add_to_memory(t, c, part, "element", buffer);
        added += " | " + part + ".x | " + part + ".y";
      }
      flush += (t.update != nullptr ? wake(s, t, added) : "") + "    }\n";
      in_table +=
          "void add_in_table_" + id + "(uint at, " + type.str() + " value) {\n    ivec2 limbs;\n" + limbs + "}\n";
      for (size_t site = 0; site < sites; ++site)
        at_sites[site] += "    if ((rare_" + id + " & " + number(size_t{1} << site) + "u) == 0u) add_in_table_" + id +
                          "(uint(at), kept_" + id + "[" + number(site) + "]);\n";
    }
    flush += "  }\n";
    s.declare("uint " + left + " = 0u;\nshared uint " + keys + "[" + size + "];\nshared int " + table + "[" +
              std::to_string(words * same.elements) + "];\n" + in_table +
              "// Where an element stands, or -1.\nint place_" + places +
              "(int element) {\n  uint at = uint(element % " + width + " + element / " + width + " * " +
              std::to_string(kRow) + ") % " + size + "u;\n  for (int tries = 0; tries < " + std::to_string(kTries) +
              "; ++tries) {\n    uint key = " + keys + "[at];\n    if (key == 0u) key = atomicCompSwap(" + keys +
              "[at], 0u, uint(element + 1));\n    if (key == 0u || key == uint(element + 1)) return int(at);\n"
              "    at = (at + 1u) % " +
              size + "u;\n  }\n  return -1;\n}\n");
    for (size_t site = 0; site < sites; ++site) {
      const std::string element = "kept_element_" + places + "[" + number(site) + "]";
      any += (any.empty() ? "" : " || ") + element + " >= 0";
      add += "  if (" + element + " >= 0) {\n    int at = place_" + places + "(" + element +
             ");\n    if (at < 0) {\n      " + left + " |= " + number(size_t{1} << site) + "u;\n    } else {\n" +
             at_sites[site] + "    }\n  }\n";
    }
    rest += "  for (uint some = " + rare + "; some != 0u; some &= some - 1u) {\n    int site = findLSB(some);\n" +
            "    int element = " + at_site("kept_element_" + places, sites) + ";\n" + in_memory + "  }\n";
    clear += "  for (uint at = lane; at < " + size + "u; at += " + group + "u) " + keys +
             "[at] = 0u;\n  for (uint at = lane; at < " + std::to_string(words * same.elements) + "u; at += " + group +
             "u) " + table + "[at] = 0;\n";
  }
  // Most workgroups of a picture add nothing.
  s.do_together("  uint lane = gl_LocalInvocationID.x;\n  if (lane == 0u) group_adds = 0u;\n  barrier();\n  if (" +
                any + ") group_adds = 1u;\n  barrier();\n  if (group_adds == 0u) return;\n" + clear + "  barrier();\n" +
                add + rest + "  barrier();\n" + flush);
}

}  // namespace dr::backend
