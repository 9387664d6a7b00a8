// SPDX-License-Identifier: Apache-2.0
// Contributions to exact sums that are kept between their two runs. A buffer has, for each term of the sum, the
// elements that it adds to plus 1, then its components one after the other; each of these has a word for every place in
// the list that has room.
#include "compiler/backend/emit/generator.h"
#include "compiler/backend/schedule/limits.h"

namespace dr::backend {

using glsl::component;
using glsl::dim_expression;
using glsl::Shader;

ir::Dim room_for_terms(const ir::Extent& domain) {
  constexpr int kAlways = 1024;  // at 64 words an element no more than eight bytes of the domain's
  return element_count(domain).divided_by(kElementsInTurn) + ir::Dim(kAlways);
}

namespace {

// The word of a component of a term, -1: the element, of the element of the list at `place`.
std::string word(const ir::Extent& domain, const ir::Type& type, const std::string& site, int c,
                 const std::string& place) {
  return "(" + site + " * " + std::to_string(type.components() + 1) + " + " + std::to_string(c + 1) + ") * " +
         dim_expression(room_for_terms(domain)) + " + " + place;
}

}  // namespace

ir::Dim Generator::words_of_terms(const Target& target, const ir::Extent& domain) const {
  const int words = (target.accumulator.type.components() + 1) * static_cast<int>(target.sum.terms.size());
  return room_for_terms(domain) * ir::Dim(words);
}

std::string Generator::keep_term(Shader& s, const Pass& pass, const Target& target) const {
  const ir::Type& type = target.accumulator.type;
  const std::string terms = s.bind_words(target.terms, "terms_" + target.accumulator.name, bundle::Access::Write);
  const auto at = [&](int c) {
    return terms + ".d[" + word(pass.domain, type, "site", c, "int(listed_at" + target.list + ")") + "]";
  };
  std::string out = "    if (int(listed_at" + target.list + ") < " + dim_expression(room_for_terms(pass.domain)) +
                    ") {\n      " + at(-1) + " = uint(element + 1);\n";
  for (int c = 0; c < type.components(); ++c)
    out += "      " + at(c) + " = floatBitsToUint(" + component(type, "value", c) + ");\n";
  return out + "    }\n";
}

void Generator::keep_no_terms(Shader& s, const Pass& pass, const Target& target) const {
  const std::string terms = s.bind_words(target.terms, "terms_" + target.accumulator.name, bundle::Access::Write);
  s.body().line(
      "for (int site = 0; int(listed_at" + target.list + ") < " + dim_expression(room_for_terms(pass.domain)) +
      " && site < " + std::to_string(target.sum.terms.size()) + "; ++site) " + terms + ".d[" +
      word(pass.domain, target.accumulator.type, "site", -1, "int(listed_at" + target.list + ")") + "] = 0u;");
}

void Generator::add_kept_terms(Shader& s, const Pass& pass, const std::vector<Target>& targets) const {
  const std::string room = dim_expression(room_for_terms(pass.domain));
  s.body().line("int kept = min(end, " + room + ");");
  for (const Target& t : targets) {
    const ir::Type& type = t.accumulator.type;
    const std::string& id = t.accumulator.name;
    const std::string terms = s.read_words(t.terms, "terms_" + id);
    const auto load = [&](int c) { return terms + "(" + word(pass.domain, type, "site", c, "place") + ")"; };
    std::string value;
    for (int c = 0; c < type.components(); ++c) value += (c > 0 ? ", " : "") + ("uintBitsToFloat(" + load(c) + ")");
    s.body().line("for (int item = index; item < kept * " + std::to_string(t.sum.terms.size()) + "; item += " + room +
                  ") {\n    int site = item / kept, place = item - site * kept;\n    int element = int(" + load(-1) +
                  ") - 1;\n    " + type.str() + " value = " + type.str() + "(" + value +
                  ");\n    if (element >= 0) add_" + id + "(element, value);\n  }");
  }
}

}  // namespace dr::backend
