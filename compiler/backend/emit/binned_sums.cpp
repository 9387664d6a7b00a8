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
// element, four bits a component: see special_flag.
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
    s.declare("void add_to_bin_" + id + "(int bin, uint x, bool minus) {\n  if (x != 0u) atomicAdd(" + buffer +
              ".d[bin], minus ? ~uint64_t(x) + uint64_t(1) : uint64_t(x));\n}\n");
  } else {
    s.declare("void add_to_bin_" + id +
              "(int bin, uint x, bool minus) {\n  if (x == 0u) return;\n  uint low = minus ? ~x + 1u : x;\n"
              "  uint old = atomicAdd(" +
              buffer + ".d[2 * bin], low);\n  uint high = (minus ? 0xffffffffu : 0u) + uint(old + low < old);\n" +
              "  if (high != 0u) atomicAdd(" + buffer + ".d[2 * bin + 1], high);\n}\n");
  }
  Adding out;
  // The other sums of the pass have a first run, in which these add nothing.
  if (runs == Runs::Both && lists) out.body += "  if (pc.a == 0) adds |= " + any_bits(type, "value") + ";\n";
  if (runs == Runs::Both) out.body += "  if (pc.a != 0) {\n";
  out.body += "  uint flags = 0u;\n";
  for (int c = 0; c < n; ++c)
    out.body += "  flags |= special_flag(" + component(type, "value", c) + ") << " + std::to_string(4 * c) + ";\n";
  for (int c = 0; c < n; ++c) {
    const std::string k = std::to_string(c), part = "part_" + k, bin = "bin_" + k, adds = "adds_" + k;
    const std::string x = component(type, "value", c);
    out.body += "  uvec2 " + part + " = " + s.at_once(ir::vec(2, ir::Scalar::Uint), "in_bins(" + x + ")") + ";\n";
    out.body += "  if (" + part + " != uvec2(0u)) {\n    int " + bin + " = (element * " + std::to_string(n) + " + " +
                k + ") * " + std::to_string(kBins) + " + bin_of(" + x + ");\n";
    if (joins) out.body += "    bool " + adds + " = true;\n" + join_lanes(part, bin, adds);
    if (joins) out.body += "    if (" + adds + ") {\n";
    out.body += "    bool minus = (" + part + ".y >> 31) != 0u;\n    uvec2 words = bins_magnitude(" + part +
                ");\n    add_to_bin_" + id + "(" + bin + ", words.x, minus);\n    add_to_bin_" + id + "(" + bin +
                " + 1, words.y, minus);\n";
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
  s.declare("float " + function + "(int bin, uint flags) {\n  uvec2 sum = uvec2(0u);\n  for (int k = 0; k < " + count +
            "; ++k) sum = bin_carried(" + bin + ", sum);\n" +
            "  BinDigits digits = bin_digits(uint(int(sum.y) >> 31));\n  for (int k = 0; k < " + count +
            "; ++k) digits = with_bin(digits, " + bin + ", 32 * k);\n" +
            "  return bins_to_float(with_bin(digits, uvec2(0u), 32 * " + count + "), flags);\n}\n");
  FloatSums out;
  out.statements =
      "uint flags = uint(" + sums + "(" + glsl::dim_expression(words_before_flags(type, extent, wide)) + " + index));";
  const int n = type.components();
  for (int c = 0; c < n; ++c)
    out.components.push_back(function + "((index * " + std::to_string(n) + " + " + std::to_string(c) + ") * " + count +
                             ", (flags >> " + std::to_string(4 * c) + ") & 15u)");
  return out;
}

}  // namespace dr::backend
