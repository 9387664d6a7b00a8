// SPDX-License-Identifier: Apache-2.0
// Exact sums that a second run adds, joined by two lanes beside each other: neighbours in a picture often read the same
// texels. Where all places of both are the same, the first lane adds for both, as integers. A lane keeps what it adds
// until its element is done.
#include "compiler/backend/emit/generator.h"
#include "compiler/backend/glsl/fixed_point.h"

namespace dr::backend {

using glsl::Shader;

namespace {

std::string at(const std::string& array, size_t k) { return array + "[" + std::to_string(k) + "]"; }

}  // namespace

std::string Generator::keep_for_pair(Shader& s, const Target& t) {
  const std::string &id = t.accumulator.name, sites = std::to_string(t.sum.terms.size());
  s.declare("int kept_element_" + id + "[" + sites + "];\n" + t.accumulator.type.str() + " kept_" + id + "[" + sites +
            "];\n");
  return "  kept_element_" + id + "[site] = element;\n  kept_" + id + "[site] = value;\n";
}

std::string Generator::begin_pair(const Target& t) {
  std::string out;
  for (size_t k = 0; k < t.sum.terms.size(); ++k)
    out += (k > 0 ? " " : "") + at("kept_element_" + t.accumulator.name, k) + " = -1;";
  return out;
}

std::string Generator::join_in_pair(Shader& s, const Target& t) {
  const std::string &id = t.accumulator.name, elements = "kept_element_" + id;
  subgroup_extensions(s);
  s.extension("GL_KHR_shader_subgroup_shuffle");
  s.prelude(glsl::kFixedAdd);
  const std::string buffer = s.bind_words(t.words, "sums_" + id, bundle::Access::ReadWrite, sum_word());
  std::string parameters, parts, shuffles;
  for (int c = 0; c < t.accumulator.type.components(); ++c) {
    const std::string part = "part_" + std::to_string(c), other = "other_" + std::to_string(c);
    parameters += ", uvec2 " + part;
    parts += ", " + part;
    shuffles += "  uvec2 " + other + " = subgroupShuffleXor(" + part + ", 1u);\n  if (takes) " + part +
                " = fixed_add(" + part + ", " + other + ");\n";
  }
  s.declare("void add_parts_" + id + "(int element, uint flags" + parameters + ") {\n" + add_parts(s, t, buffer) +
            "}\nvoid join_site_" + id + "(int element, " + t.accumulator.type.str() +
            " value, bool takes, bool gives) {\n" + fixed_parts(s, t) + shuffles +
            "  uint others = subgroupShuffleXor(flags, 1u);\n  if (takes) flags |= others;\n"
            "  if (element >= 0 && !gives) add_parts_" +
            id + "(element, flags" + parts + ");\n}\n");
  std::string join = "void join_" + id +
                     "() {\n  uint lane = gl_SubgroupInvocationID;\n  int apart = 0;\n"
                     "  bool paired = subgroupBallotBitExtract(subgroupBallot(true), lane ^ 1u);\n";
  for (size_t k = 0; k < t.sum.terms.size(); ++k)
    join += "  apart |= subgroupShuffleXor(" + at(elements, k) + ", 1u) ^ " + at(elements, k) + ";\n";
  join += "  bool same = paired && apart == 0, takes = same && (lane & 1u) == 0u, gives = same && !takes;\n";
  for (size_t k = 0; k < t.sum.terms.size(); ++k)
    join += "  join_site_" + id + "(" + at(elements, k) + ", " + at("kept_" + id, k) + ", takes, gives);\n";
  s.declare(join + "}\n");
  return "join_" + id + "();";
}

}  // namespace dr::backend
