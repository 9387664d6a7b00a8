// SPDX-License-Identifier: Apache-2.0
// NaN and Inf in what a step leaves behind: a word of the pass that stores it, which the host reads between runs. The
// value is in a register there, so that the look at it is one comparison.
#include "compiler/backend/emit/generator.h"

namespace dr::backend {

using glsl::Shader;
using ir::ValueId;

void Generator::tell_not_finite(Shader& s, const Pass& pass) {
  if (pass.code.told.empty()) return;
  std::string any;
  for (const ValueId v : pass.code.told) {
    const ir::Type& t = resource(v).type;
    for (int c = 0; c < t.components(); ++c)
      any += (any.empty() ? "" : " || ") + std::string("is_not_finite(") + glsl::component(t, s.use(v), c) + ")";
  }
  auto [it, is_new] = finite_words_.try_emplace(&pass);
  if (is_new) {
    it->second = add_scratch(pass.name + "_not_finite", "1");
    bundle_->resources[it->second]->role = bundle::Role::Watch;
  }
  // Infinity and NaN have all bits of the exponent.
  s.prelude("bool is_not_finite(float x) { return (floatBitsToUint(x) & 0x7f800000u) == 0x7f800000u; }\n");
  const std::string word = s.bind_words(it->second, "not_finite", bundle::Access::ReadWrite);
  s.body().line("if (" + any + ") " + word + ".d[0] = 1u;");
  finite_ = static_cast<int>(it->second);
}

}  // namespace dr::backend
