// SPDX-License-Identifier: Apache-2.0
// Exact sums that a map adds to, joined by its workgroups. Each invocation keeps what it adds until it is done with its
// element. Then the workgroup adds it up in a table of its own, by element, as integers, and adds the table to memory:
// pixels of a square share most of the texels, or vertices, that they add to. Elements for which the table has no room
// are added to memory.
#include "compiler/backend/emit/generator.h"
#include "compiler/backend/glsl/fixed_point.h"
#include "compiler/backend/schedule/limits.h"

namespace dr::backend {

using glsl::Shader;

namespace {

// Places of the table that are tried for an element.
constexpr int kTries = 3;
// Rows of elements lie so far apart in the table that those of a square of pixels do not meet, nor the words of a
// subgroup's pixels in one bank of the workgroup's memory.
constexpr int kRow = 24;

}  // namespace

std::string Generator::keep_for_group(Shader& s, const Target& t) {
  const std::string& id = t.accumulator.name;
  const ir::Type& type = t.accumulator.type;
  const std::string sites = std::to_string(t.sum.terms.size());
  std::string none;
  for (size_t k = 0; k < t.sum.terms.size(); ++k) none += (k > 0 ? ", -1" : "-1");
  s.declare("int kept_element_" + id + "[" + sites + "] = int[" + sites + "](" + none + ");\n" + type.str() + " kept_" +
            id + "[" + sites + "];\n");
  return "    if ((" + any_bits(type, "value") + ") != 0u) {\n      kept_element_" + id +
         "[site] = element;\n      kept_" + id + "[site] = value;\n    }\n";
}

void Generator::join_in_group(Shader& s, const std::vector<Target>& targets) {
  const std::string group = std::to_string(kJoiningGroup);
  s.declare("shared uint group_adds;\n");
  std::string any, clear, add, flush;
  std::vector<const ScatterSum*> all;
  for (const Target& t : targets) all.push_back(&t.sum);
  const std::vector<int> rooms = joined_elements(graph_, all);
  DR_ASSERT(rooms.size() == targets.size());
  for (size_t place = 0; place < targets.size(); ++place) {
    const Target& t = targets[place];
    const std::string& id = t.accumulator.name;
    const ir::Type& type = t.accumulator.type;
    const int n = type.components(), room = rooms[place];
    const std::string size = std::to_string(room), keys = "keys_" + id, sums = "group_" + id;
    const std::string buffer = s.bind_words(t.words, "sums_" + id, bundle::Access::ReadWrite, sum_word());
    const std::string width = glsl::dim_expression(t.accumulator.extent.w);
    const auto word = [&](const std::string& at, int k) {
      return sums + "[" + at + " + " + std::to_string(k * room) + "]";
    };
    std::string here, memory;
    for (int c = 0; c < n; ++c) {
      const std::string part = "part_" + std::to_string(c);
      here += "    if (" + part + " != uvec2(0u)) {\n      uint old = atomicAdd(" + word("at", 2 * c) + ", " + part +
              ".x);\n      atomicAdd(" + word("at", 2 * c + 1) + ", " + part + ".y + uint(old + " + part +
              ".x < old));\n    }\n";
      memory += "  " + add_to_memory(t, c, part, "element", buffer);
    }
    s.declare("shared uint " + keys + "[" + size + "], " + sums + "[" + std::to_string(2 * n * room) +
              "];\nvoid add_in_group_" + id + "(int element, " + type.str() + " value) {\n" + fixed_parts(s, t) +
              "  uint at = uint(element % " + width + " + element / " + width + " * " + std::to_string(kRow) + ") % " +
              size + "u, key = 0u;\n  for (int tries = 0; tries < " + std::to_string(kTries) +
              "; ++tries) {\n"
              "    key = " +
              keys + "[at];\n    if (key == 0u) key = atomicCompSwap(" + keys +
              "[at], 0u, uint(element + 1));\n"
              "    if (key == 0u || key == uint(element + 1)) break;\n    at = (at + 1u) % " +
              size +
              "u;\n  }\n"
              "  if (key == 0u || key == uint(element + 1)) {\n" +
              here + "  } else {\n" + memory + (t.update == nullptr ? "" : wake(s, t, "1u")) + "  }\n" +
              set_flags(t, buffer) + (t.update == nullptr ? "" : wake(s, t, "flags")) + "}\n");
    for (size_t k = 0; k < t.sum.terms.size(); ++k) {
      const std::string site = "[" + std::to_string(k) + "]", element = "kept_element_" + id + site;
      any += (any.empty() ? "" : " || ") + element + " >= 0";
      add += "  if (" + element + " >= 0) add_in_group_" + id + "(" + element + ", kept_" + id + site + ");\n";
    }
    clear += "  for (uint at = lane; at < " + size + "u; at += " + group + "u) " + keys +
             "[at] = 0u;\n  for (uint at = lane; at < " + std::to_string(2 * n * room) + "u; at += " + group + "u) " +
             sums + "[at] = 0u;\n";
    flush += "  for (uint at = lane; at < " + size + "u; at += " + group + "u) {\n    int element = int(" + keys +
             "[at]) - 1;\n    if (element < 0) continue;\n";
    std::string added = "0u";
    for (int c = 0; c < n; ++c) {
      added += " | part_" + std::to_string(c) + ".x | part_" + std::to_string(c) + ".y";
      flush += "    uvec2 part_" + std::to_string(c) + " = uvec2(" + word("at", 2 * c) + ", " + word("at", 2 * c + 1) +
               ");\n  " + add_to_memory(t, c, "part_" + std::to_string(c), "element", buffer);
    }
    if (t.update != nullptr) flush += wake(s, t, added);
    flush += "  }\n";
  }
  // Most workgroups of a picture add nothing.
  s.do_together("  uint lane = gl_LocalInvocationID.x;\n  if (lane == 0u) group_adds = 0u;\n  barrier();\n  if (" +
                any + ") group_adds = 1u;\n  barrier();\n  if (group_adds == 0u) return;\n" + clear + "  barrier();\n" +
                add + "  barrier();\n" + flush);
}

}  // namespace dr::backend
