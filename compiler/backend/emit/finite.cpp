// SPDX-License-Identifier: Apache-2.0
// NaN and Inf in what a step leaves behind: a word of the pass that stores it, which the host reads between runs. The
// values are in registers there, so that the look at them all is one comparison.
#include "compiler/backend/emit/generator.h"

namespace dr::backend {

using glsl::Shader;
using ir::ValueId;

// Without their signs, Infinity and NaN are the largest of all floats as integers: one comparison looks at them all.
std::string Generator::largest_bits(Shader& s, const std::vector<ValueId>& told) const {
  s.prelude("uint size_bits(float x) { return floatBitsToUint(x) & 0x7fffffffu; }\n");
  std::string any;
  for (const ValueId v : told) {
    const ir::Type& t = resource(v).type;
    for (int c = 0; c < t.components(); ++c) {
      const std::string one = "size_bits(" + glsl::component(t, s.use(v), c) + ")";
      any = any.empty() ? one : "max(" + any + ", " + one + ")";
    }
  }
  return any;
}

void Generator::tell_not_finite(Shader& s, const Pass& pass, const std::string& largest) {
  auto [it, is_new] = finite_words_.try_emplace(&pass);
  if (is_new) it->second = add_watch(pass.name + "_not_finite");
  const std::string word = s.bind_words(it->second, "not_finite", bundle::Access::ReadWrite);
  s.body().line("if (" + largest + " >= 0x7f800000u) " + word + ".d[0] = 1u;");
  finite_ = static_cast<int>(it->second);
}

}  // namespace dr::backend
