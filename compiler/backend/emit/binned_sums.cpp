// SPDX-License-Identifier: Apache-2.0
// Float sums of few elements (analysis/bins.h): one run adds whole numbers to bins over all exponents, and floats are
// made of them where they are read, by one rounding.
#include "compiler/backend/analysis/bins.h"
#include "compiler/backend/emit/generator.h"
#include "compiler/backend/glsl/bins.h"
#include "compiler/backend/glsl/fixed_point.h"

namespace dr::backend {

using glsl::component;
using glsl::Shader;

namespace {

// Words of an accumulator, of 32 bits or of 64: the bins of each component of each element, then flags for each
// element, two bits a component: see special_flag.
ir::Dim words_before_flags(const ir::Type& type, const ir::Extent& extent, bool wide) {
  return element_count(extent) * ir::Dim((wide ? 1 : 2) * kBins * type.components());
}

// Lanes of a subgroup that add to the same bins join their parts, as in fixed_sums.cpp.
std::string join_lanes(const std::string& part, const std::string& bin, const std::string& adds) {
  return "    for (int round = 0; joins && round < " + std::to_string(kJoinRounds) +
         "; ++round) {\n      bool same = subgroupBroadcastFirst(" + bin + ") == " + bin +
         ";\n      uvec4 lanes = subgroupBallot(same);\n      if (same) {\n"
         "        if (subgroupBallotBitCount(lanes) > 1u) {\n          " +
         part + " = fixed_subgroup_add(" + part + ");\n          " + adds +
         " = subgroupElect();\n        }\n        break;\n      }\n    }\n";
}

}  // namespace

ir::Dim words_of_bins(const ir::Type& type, const ir::Extent& extent, bool wide) {
  return (words_before_flags(type, extent, wide) + element_count(extent)) * ir::Dim(wide ? 2 : 1);
}

Generator::Adding Generator::binned_adding(Shader& s, const Pass& pass, const Target& t, Runs runs, bool lists) {
  const bool joins = pass.get<ScatterPass>().joins_parts() && pass.get<ScatterPass>().joined_run() == nullptr;
  const std::string& id = t.accumulator.name;
  const ir::Type& type = t.accumulator.type;
  const int n = type.components();
  const bool wide = wide_atomics();
  const std::string buffer = s.bind_words(t.words, "sums_" + id, bundle::Access::ReadWrite, sum_word());
  if (wide) wide_extensions(s);
  if (joins) subgroup_extensions(s);
  s.prelude(glsl::kFixedShift);
  s.prelude(glsl::kFixedFromFloat);
  s.prelude(glsl::kBins);
  s.prelude(joins ? glsl::kFixedSubgroup : "");
  if (wide) {
    s.declare("bool overflows_" + id + "(int bin, uvec2 part) {\n  uint64_t x = wide_of(part), old = atomicAdd(" +
              buffer +
              ".d[bin], x), sum = old + x;\n  return (uint((old ^ sum) >> 63) & uint((x ^ sum) >> 63)) != 0u;\n}\n");
  } else {
    s.declare("bool overflows_" + id + "(int bin, uvec2 part) {\n  uint low = 0u, high = part.y;\n" +
              "  if (part.x != 0u) low = atomicAdd(" + buffer +
              ".d[2 * bin], part.x);\n  high += uint(low + part.x < low);\n  if (high == 0u) return false;\n" +
              "  uint old = atomicAdd(" + buffer +
              ".d[2 * bin + 1], high), sum = old + high;\n  return (((old ^ sum) & (high ^ sum)) >> 31) != 0u;\n}\n");
  }
  s.declare("void add_to_bin_" + id + "(int bin, uvec2 part) {\n  if (!overflows_" + id +
            "(bin, part)) return;\n  part = bin_overflow(part);\n  for (++bin; overflows_" + id +
            "(bin, part);) ++bin;\n}\n");
  Adding out;
  // The other sums of the pass have a first run, in which these add nothing.
  if (runs == Runs::Both && lists) out.body += "  if (pc.a == 0) adds |= " + any_bits(type, "value") + ";\n";
  if (runs == Runs::Both) out.body += "  if (pc.a != 0) {\n";
  out.body += "  uint flags = 0u;\n";
  for (int c = 0; c < n; ++c) out.body += "  flags |= " + flag_of(component(type, "value", c), c) + ";\n";
  for (int c = 0; c < n; ++c) {
    const std::string k = std::to_string(c), part = "part_" + k, bin = "bin_" + k, adds = "adds_" + k;
    const std::string x = component(type, "value", c);
    out.body += "  uvec2 " + part + " = " + s.at_once(ir::vec(2, ir::Scalar::Uint), "in_bin(" + x + ")") + ";\n";
    out.body += "  if (" + part + " != uvec2(0u)) {\n    int " + bin + " = (element * " + std::to_string(n) + " + " +
                k + ") * " + std::to_string(kBins) + " + bin_of(" + x + ");\n";
    if (joins) out.body += "    bool " + adds + " = true;\n" + join_lanes(part, bin, adds);
    if (joins) out.body += "    if (" + adds + ") {\n";
    out.body += "    add_to_bin_" + id + "(" + bin + ", " + part + ");\n";
    out.body += joins ? "    }\n  }\n" : "  }\n";
  }
  const std::string flags = glsl::dim_expression(words_before_flags(type, t.accumulator.extent, wide)) + " + element";
  out.body += "  if (flags != 0u) atomicOr(" + buffer + ".d[" + flags + "], " + sum_word() + "(flags));\n";
  if (runs == Runs::Both) out.body += "  }\n";
  return out;
}

Generator::FloatSums Generator::floats_of_bins(Shader& s, const ir::Type& type, const ir::Extent& extent,
                                               uint32_t words) const {
  const bool wide = wide_atomics();
  if (wide) wide_extensions(s);
  const std::string sums = s.read_words(words, "sums_" + std::to_string(words), sum_word());
  s.prelude(glsl::kBinsToFloat);
  const std::string function = "sum_of_bins_" + std::to_string(words), count = std::to_string(kBins);
  const std::string bin =
      wide ? "words_of(" + sums + "(bin + k))" : "uvec2(" + sums + "(2 * (bin + k)), " + sums + "(2 * (bin + k) + 1))";
  // Beyond the last bin is what it carries.
  s.declare("float " + function + "(int bin, uint flags) {\n  uvec3 sum = uvec3(0u);\n  for (int k = 0; k < " + count +
            "; ++k) sum = bin_digit(sum, " + bin + ");\n  sum = bin_digit(sum, uvec2(0u));\n" +
            "  BinDigits digits = bin_digits(uint(int(sum.y) >> 31));\n  for (int k = 0; k < " + count +
            "; ++k) digits = with_bin(digits, " + bin + ", 32 * k);\n" +
            "  return bins_to_float(with_bin(digits, uvec2(0u), 32 * " + count + "), flags);\n}\n");
  FloatSums out;
  out.statements =
      "uint flags = uint(" + sums + "(" + glsl::dim_expression(words_before_flags(type, extent, wide)) + " + index));";
  const int n = type.components();
  for (int c = 0; c < n; ++c)
    out.components.push_back(function + "((index * " + std::to_string(n) + " + " + std::to_string(c) + ") * " + count +
                             ", " + flag_at("flags", std::to_string(kFlagBits * c)) + ")");
  return out;
}

}  // namespace dr::backend
