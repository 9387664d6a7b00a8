// SPDX-License-Identifier: Apache-2.0
// std.rig: a chain of joints, a skin of 40 vertices on it, and shapes that blend.
#include "tests/device/accuracy/library_table.h"

namespace dr::accuracy::library {

namespace {

constexpr const char* kJoints = "[6]";
constexpr const char* kSkin = "[40]";
const char* const kChain = "products of up to 6 matrices, 4 roundings an entry each";

Operands skin() {
  return {whole(vectors("p", -2, 2, 1e-3), kSkin), whole(vectors("turn", -3, 3, 1e-6), kJoints),
          whole(vectors("shift", -1, 1, 1e-3), kJoints),
          made("bone", "ivec4", "ivec4(coord(40).x % 6, (coord(40).x + 1) % 6, (coord(40).x + 2) % 6, 0)", kSkin),
          whole(vectors("w", 0, 1, 1e-3, "vec4"), kSkin)};
}
const std::string kMatrices = "  let m = camera.rigid(turn, shift);\n";

}  // namespace

std::vector<Function> rig_functions() {
  const Operand rotation = vectors("rotation", -3, 3, 1e-6);
  const Operands chain = {whole(vectors("turn", -3, 3, 1e-6), kJoints), whole(vectors("shift", -1, 1, 1e-3), kJoints),
                          made("parent", "int", "coord(6).x - 1", kJoints)};
  const Direction to_turn = l2("turn", 2e-6, kChain), to_shift = l2("shift", 2e-6, kChain);
  return {
      {.name = "rig.blended",
       .part = {},
       .result = "vec3[40]",
       .operands = {whole(vectors("p", -2, 2, 1e-3), kSkin), whole(vectors("shapes", -1, 1, 1e-3), "[40, 9]"),
                    whole(vectors("w", -1, 1, 1e-3, "float"), "[9]")},
       .value = "rig.blended(p, shapes, w)",
       .directions = {l2("value", 4 * u, "sums of 10 terms"), l2("p", u, "nothing is rounded"),
                      l2("shapes", 4 * u, kFew), l2("w", 8 * u, "sums of 120 terms")},
       .whole = true},
      {.name = "rig.joint",
       .part = {},
       .result = "mat4",
       .operands = {vectors("rest", -4, 4, 1e-3, "mat4"), rotation},
       .value = "rig.joint(rest, rotation)",
       .directions = all_conditioned(64 * u, 256 * u, {"rest", "rotation"})},
      {.name = "rig.quaternion_matrix",
       .part = {},
       .result = "mat3",
       .operands = {vectors("q", -4, 4, 1e-3, "vec4")},
       .value = "rig.quaternion_matrix(q)",
       .directions = all_conditioned(16 * u, 64 * u, {"q"})},
      {.name = "rig.chained",
       .part = {},
       .result = "mat4[6]",
       .operands = chain,
       .value = "rig.chained(camera.rigid(turn, shift), parent)",
       .directions = {l2("value", 2e-6, kChain), to_turn, to_shift},
       .whole = true},
      {.name = "rig.skin_matrices",
       .part = {},
       .result = "mat4",
       .operands = {vectors("posed", -4, 4, 1e-3, "mat4"), vectors("inverse_bind", -4, 4, 1e-3, "mat4")},
       .value = "rig.skin_matrices(posed, inverse_bind)",
       .directions = all_conditioned(16 * u, 16 * u, {"posed", "inverse_bind"})},
      {.name = "rig.frame_at",
       .part = {},
       .result = "mat4[6]",
       .operands = {whole(vectors("frames", -4, 4, 1e-3, "mat4"), "[6, 5]"),
                    whole(floats("place", -1, 6, 1e-3), "[1]")},
       .value = "rig.frame_at(frames, place)",
       .directions = {l2("value", 4 * u, kFew), l2("frames", 4 * u, kFew)},
       .whole = true},
      {.name = "rig.skinned",
       .part = {},
       .result = "vec3[40]",
       .operands = skin(),
       .value = "rig.skinned(p, bone, w, m)",
       .directions = {l2("value", 1e-6, kChain), l2("p", 1e-6, kChain), to_turn, to_shift, l2("w", 1e-6, kChain)},
       .before = kMatrices,
       .whole = true},
      {.name = "rig.skinned_normal",
       .part = {},
       .result = "vec3[40]",
       .operands = skin(),
       .value = "rig.skinned_normal(normalize(p), bone, w, m)",
       .directions = {l2("value", 1e-5, "mixed turns that nearly cancel leave differences"),
                      l2("turn", 1e-3, "where they do, the normal turns fast")},
       .before = kMatrices,
       .whole = true},
  };
}

}  // namespace dr::accuracy::library
