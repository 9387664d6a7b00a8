// SPDX-License-Identifier: Apache-2.0
// std.material, the lamps of std.light that it is made for, and std.tone.
#include "tests/device/accuracy/library_table.h"

namespace dr::accuracy::library {

namespace {

// The design's for whole frames: each value here is a product of the terms whose rows are above it, with the error of
// ggx where light is mirrored nearly exactly.
constexpr double kWhole = 1e-4;

Operand alpha() { return floats("alpha", 2e-3, 1, 2e-3); }
Operand cosine(const std::string& name) { return floats(name, 1e-6, 1, 1e-6); }

// A view at a cosine of 1e-3 or more to a normal, and light that leaves around its mirrored direction, as far off as
// the lobe of `alpha` is wide: where ggx is ill-conditioned.
Operands lobe() {
  return join({unit("n"),
               {alpha(), floats("n_v_", 1e-3, 1, 1e-3), vectors("aside_", -1, 1, 1e-3), floats("far_", 0, 4, 1e-4),
                made("v", "vec3", "normalize(n_v_ * n + sqrt(1.0 - n_v_ * n_v_) * normalize(cross(n, aside_)))"),
                made("l", "vec3", "normalize(reflect(-v, n) + far_ * alpha * normalize(aside_))")}});
}

// A relative error of `bound` over `alpha`: the cross product is off by 2 u, the slope of the lobe is 2 / alpha at
// most.
Direction over_alpha(const std::string& of, const std::string& size, const std::string& text) {
  return over(of, 4 * u, "(1.0 / alpha + 2.0) * " + size, "(1 / alpha + 2) " + text, kBeforehand);
}

const char* const kSlopes = "the slopes of the terms, times 1 + (|ior^2 - 1| + c^2) / |ior^2 - 1 + c^2|";
const char* const kRoot = "the root of a difference";

// The root of a difference, and the slopes of the two roots: both polarizations' slopes cancel at right angles.
const std::string kFresnelSlopes =
    "  let more = (ior - 1.0) * (ior + 1.0);\n"
    "  let t = sqrt(max(more + cosine * cosine, 1e-12));\n"
    "  let wide = 1.0 + (abs(more) + cosine * cosine) / (t * t);\n"
    "  let i2 = ior * ior;\n"
    "  let (q, r) = (cosine + t, i2 * cosine + t);\n"
    "  let (s, p) = (more / (q * q), more * ((i2 + 1.0) * cosine * cosine - 1.0) / (r * r));\n"
    "  let cut = abs(more) * (i2 + 1.0) * cosine / (r * r);\n"
    "  let to_cosine = 2.0 * s * s / t + 2.0 * abs(p) * (cut + abs(p) * (i2 + cosine / t) / r);\n"
    "  let apart = 1.0 / (q * q) + 1.0 / (r * r);\n"
    "  let to_ior = 2.0 * ior * (abs(s) + abs(p)) * apart +\n"
    "               2.0 * ior * (s * s / (q * t) + p * p * (2.0 * cosine + 1.0 / t) / r);\n";

std::vector<Function> terms() {
  const Operand h = vectors("h", -2, 2, 1e-3);
  const Operands frame = {
      vectors("l_", -1, 1, 1e-3), vectors("v_", -1, 1, 1e-3), vectors("alpha", 2e-3, 1, 2e-3, "vec2"),
      made("l", "vec3", "normalize(vec3(l_.xy, abs(l_.z)))"), made("v", "vec3", "normalize(vec3(v_.xy, abs(v_.z)))")};
  // Slopes of k^2 / pi, k = alpha / (s^2 + c^2 alpha^2): to alpha 2 D / alpha, to the directions 2 D / (alpha |h|).
  Function ggx{.name = "material.ggx",
               .part = {},
               .result = "float",
               .operands = join({lobe(), {made("h", "vec3", "normalize(l + v)")}}),
               .value = "material.ggx(n, h, alpha)",
               .directions = {over_alpha("value", "y", "D"),
                              over("alpha", 16 * u, "(1.0 / alpha + 2.0) * 2.0 * abs(g) * y / alpha",
                                   "(1 / alpha + 2) 2 D / alpha |adjoint|", "like the value, of a difference"),
                              over("n", 16 * u, "(1.0 / alpha + 2.0) * 2.0 * abs(g) * y / alpha",
                                   "(1 / alpha + 2) 2 D / alpha |adjoint|", "like the value"),
                              over("h", 16 * u, "(1.0 / alpha + 2.0) * 2.0 * abs(g) * y / alpha",
                                   "(1 / alpha + 2) 2 D / alpha |adjoint|", "like the value")},
               .domain = "h within the lobe"};
  // Drivers that may take 1 - (1 - c) - c for 0 lose what the difference is rounded by.
  Direction schlick = relative("value", 8 * u, kBeforehand);
  schlick.native = 9 * u;
  schlick.native_why = "five times the difference's rounding, and four products";
  return {
      {.name = "material.alpha_of",
       .part = {},
       .result = "float",
       .operands = {floats("roughness", -0.5, 1.5, 1e-6)},
       .value = "material.alpha_of(roughness)",
       .directions = {relative("value", 8 * u, kFew), over("roughness", 8 * u, "2.0 * abs(g)", "2 |adjoint|", kFew)}},
      {.name = "material.dielectric_straight",
       .part = {},
       .result = "vec3",
       .operands = {floats("ior", 1, 4, 1), floats("specular", 0, 1, 1e-3), vectors("color", 0, 2, 1e-3)},
       .value = "material.dielectric_straight(ior, specular, color)",
       .directions = all_conditioned(16 * u, 16 * u, {"ior", "specular", "color"})},
      {.name = "material.mirror_of",
       .part = {},
       .result = "vec3",
       .operands = {vectors("base", 0, 1, 1e-3), floats("metallic", 0, 1, 1e-3), floats("ior", 1, 4, 1)},
       .value = "material.mirror_of(material.Material(base = base, metallic = metallic, ior = ior)).straight",
       .directions = all_conditioned(16 * u, 16 * u, {"base", "metallic", "ior"})},
      ggx,
      {.name = "material.visibility",
       .part = {},
       .result = "float",
       .operands = {cosine("n_l"), cosine("n_v"), alpha()},
       .value = "material.visibility(n_l, n_v, alpha)",
       .directions = {relative("value", 1e-6, kBeforehand), conditioned("n_l", 32 * u), conditioned("n_v", 32 * u),
                      conditioned("alpha", 32 * u)}},
      {.name = "material.ggx_anisotropic",
       .part = {},
       .result = "float",
       .operands = {h, vectors("alpha", 2e-3, 1, 2e-3, "vec2")},
       .value = "material.ggx_anisotropic(h, alpha)",
       .directions = all_conditioned(32 * u, 64 * u, {"h", "alpha"})},
      {.name = "material.visibility_anisotropic",
       .part = {},
       .result = "float",
       .operands = frame,
       .value = "material.visibility_anisotropic(l, v, alpha)",
       .directions = all_conditioned(32 * u, 64 * u, {"l", "v", "alpha"})},
      {.name = "material.schlick",
       .part = {},
       .result = "float",
       .operands = {floats("cosine", -0.1, 1.1, 1e-6)},
       .value = "material.schlick(cosine)",
       .directions = {schlick, relative("cosine", 16 * u, "like the value, five times its slope")}},
      {.name = "material.fresnel",
       .part = {},
       .result = "float",
       .operands = {cosine("cosine"), floats("ior", 0.4, 4, 0.4)},
       .value = "material.fresnel(cosine, ior)",
       .directions = {conditioned("value", 64 * u, "the root of a difference, twice"),
                      over("cosine", 16 * u, "wide * to_cosine * abs(g)", kSlopes, kRoot),
                      over("ior", 16 * u, "wide * to_ior * abs(g)", kSlopes, kRoot)},
       .before = kFresnelSlopes},
      {.name = "material.fresnel_rise",
       .part = {},
       .result = "float",
       .operands = {cosine("cosine"), floats("ior", 1.01, 4, 1.01)},
       .value = "material.fresnel_rise(cosine, ior)",
       .directions = {over("value", 64 * u, "wide / least", "wide / (1 - F at right angles)", kRoot),
                      over("cosine", 64 * u, "wide * to_cosine * abs(g) / least", kSlopes, kRoot),
                      over("ior", 64 * u, "wide * (to_ior + 1.0) * abs(g) / (least * least)", kSlopes, kRoot)},
       .before = kFresnelSlopes + "  let least = 4.0 * ior / ((ior + 1.0) * (ior + 1.0));\n"},
  };
}

std::vector<Function> layers() {
  const Operands operands = {vectors("base", 0, 1, 1e-3), cosine("n_l"), cosine("n_v"), floats("l_v", -1, 1, 1e-3),
                             floats("roughness", 0, 1, 1e-3)};
  const auto layer = [&](const std::string& name, Directions directions) {
    return Function{.name = "material." + name,
                    .part = {},
                    .result = "vec3",
                    .operands = operands,
                    .value = "material." + name + "(base, n_l, n_v, l_v, roughness)",
                    .directions = std::move(directions)};
  };
  return {layer("lambert", {relative("value", 2 * u, kFew), relative("base", 2 * u, kFew)}),
          layer("burley", all_conditioned(32 * u, 64 * u, {"base", "n_l", "n_v", "l_v", "roughness"})),
          layer("eon", all_conditioned(64 * u, 128 * u, {"base", "n_l", "n_v", "l_v", "roughness"}))};
}

const std::string kMaterial = "  let m = material.Material(base = base, metallic = metallic, roughness = roughness);\n";
const std::string kLit = kMaterial + "  let lamp = light.Light(l, vec3(3.0, 2.0, 1.0));\n";

std::vector<Function> lit_surfaces() {
  const auto framed = [](Direction d) {
    d.except = "length(cross(n, t)) <= 1e-2";
    d.except_text = "tangents along the normal";
    return d;
  };
  const auto handed = [](Direction d) {
    d.except = "abs(dot(cross(n, normalize(along)), normalize(across))) <= 1e-6";
    d.except_text = "the two in one plane with the normal to 1e-6, where the sign is all rounding";
    return d;
  };
  const Operands paint = {vectors("base", 1e-3, 1), floats("metallic", 0, 1, 1e-3), floats("roughness", 0, 1, 1e-3)};
  const Operands table = {made("table", "vec3", "material.energies()", "[64, 64]")};
  const Directions directions =
      all_conditioned(kWhole, kWhole, {"base", "metallic", "roughness", "n", "l", "v"}, kBeforehand);
  return {
      {.name = "material.shade",
       .part = {},
       .result = "vec3",
       .operands = join({paint, lobe()}),
       .value = "material.shade(m, n, lamp, v)",
       .directions = directions,
       .before = kLit,
       .domain = "light within the lobe"},
      {.name = "material.shade",
       .part = "anywhere",
       .result = "vec3",
       .operands = join({paint, unit("n"), unit("l"), unit("v")}),
       .value = "material.shade(m, n, lamp, v, matt = material.burley)",
       .directions = directions,
       .before = kLit},
      {.name = "material.shade",
       .part = "exact",
       .result = "vec3",
       .operands = join({paint, unit("n"), unit("l"), unit("v")}),
       .value = "material.shade(m, n, lamp, v, exact = true)",
       .directions = directions,
       .before = kLit},
      {.name = "material.mirrored_way",
       .part = {},
       .result = "vec3",
       .operands = join({unit("n"), unit("v"), {floats("alpha", 2e-3, 0.999, 1e-3)}}),
       .value = "material.mirrored_way(n, v, alpha)",
       .directions = all_conditioned(16 * u, 32 * u, {"n", "v", "alpha"}, "a root, a reflection and a mixture")},
      {.name = "material.bent_normal",
       .part = {},
       .result = "vec3",
       .operands =
           join({unit("n"), unit("t"), unit("v"), {floats("strength", 0, 1, 1e-3), floats("roughness", 0, 1, 1e-3)}}),
       .value = "material.bent_normal(n, t, strength, roughness, v)",
       .directions = all_conditioned(64 * u, 256 * u, {"n", "t", "v", "strength", "roughness"},
                                     "three normalizations, each of the one before")},
      {.name = "material.mapped_normal",
       .part = {},
       .result = "vec3",
       .operands = join({{vectors("texel", 0, 1, 1e-3)}, unit("n"), unit("t")}),
       .value = "material.mapped_normal(texel, n, vec4(t, -1.0), 0.7)",
       .directions = {framed(conditioned("value", 16 * u)), framed(conditioned("texel", 32 * u)),
                      framed(conditioned("n", 32 * u)), framed(conditioned("t", 32 * u))}},
      {.name = "material.tangent_of",
       .part = {},
       .result = "vec4",
       .operands = join({unit("n"), {vectors("along", -2, 2, 1e-3), vectors("across", -2, 2, 1e-3)}}),
       .value = "material.tangent_of(n, along, across)",
       .directions = {handed(conditioned("value", 32 * u)), conditioned("n", 64 * u), conditioned("along", 64 * u)}},
      {.name = "material.shade_anisotropic",
       .part = {},
       .result = "vec3",
       .operands = join({paint, unit("n"), unit("l"), unit("v"), unit("t"), {floats("strength", 0, 1, 1e-3)}}),
       .value = "material.shade_anisotropic(m, n, t, strength, lamp, v)",
       .directions = all_conditioned(kWhole, kWhole, {"base", "metallic", "roughness", "n", "l", "v", "t", "strength"},
                                     kBeforehand),
       .before = kLit},
      {.name = "material.shade_full",
       .part = {},
       .result = "vec3",
       .operands = join({paint, unit("n"), unit("l"), unit("v"), table}),
       .value = "material.shade_full(m, n, lamp, v, table)",
       .directions = {conditioned("value", kWhole, kBeforehand), conditioned("base", kWhole, kBeforehand)},
       .before = kLit},
      {.name = "material.ambient",
       .part = {},
       .result = "vec3",
       .operands = join({paint, unit("n"), unit("v"), {vectors("i", 0, 8, 1e-3), vectors("s", 0, 8, 1e-3)}, table}),
       .value = "material.ambient(m, n, v, i, s, table)",
       .directions = {conditioned("value", kWhole, kBeforehand), conditioned("base", kWhole, kBeforehand),
                      conditioned("i", kWhole, kBeforehand), conditioned("s", kWhole, kBeforehand)},
       .before = kMaterial},
  };
}

std::vector<Function> energies() {
  const Operands table = {made("table", "vec3", "material.energies()", "[64, 64]")};
  const Operands at = {floats("cosine", 1e-3, 1, 1e-3), alpha()};
  const Operands mirror = {vectors("straight", 0, 1, 1e-3), vectors("grazing", 0, 1, 1e-3)};
  const std::string why = "a sum of 512 terms, of 16 roundings each";
  const std::string read = "where between texels it reads is off by 64 times a few roundings";
  return {
      {.name = "material.energy",
       .part = {},
       .result = "vec2",
       .operands = at,
       .value = "material.energy(cosine, alpha)",
       .directions = {relative("value", 64 * u, why)},
       .transposed = {"cosine", "alpha"}},
      {.name = "material.energies",
       .part = {},
       .result = "vec3[64, 64]",
       .operands = {},
       .value = "material.energies()",
       .directions = {relative("value", 64 * u, why)},
       .whole = true},
      {.name = "material.lost",
       .part = {},
       .result = "vec2",
       .operands = join({table, at}),
       .value = "material.lost(table, cosine, alpha)",
       .directions = {over("value", 64 * u, "1.0 + 0.0 * alpha", "1", read)},
       .transposed = {"table", "cosine", "alpha"}},
      {.name = "material.split_sum",
       .part = {},
       .result = "vec2",
       .operands = join({table, at}),
       .value = "material.split_sum(table, cosine, alpha)",
       .directions = {over("value", 64 * u, "1.0 + 0.0 * alpha", "1", read)},
       .transposed = {"table", "cosine", "alpha"}},
      {.name = "material.tint",
       .part = {},
       .result = "vec3",
       .operands = join({mirror, {floats("lost", 0, 0.9, 1e-3)}}),
       .value = "material.tint(straight, grazing, lost)",
       .directions = all_conditioned(32 * u, 64 * u, {"straight", "grazing", "lost"})},
      {.name = "material.again",
       .part = {},
       .result = "vec3",
       .operands = join({mirror, {floats("n_l", 1e-3, 1, 1e-3), floats("n_v", 1e-3, 1, 1e-3), alpha()}, table}),
       .value = "material.again(straight, grazing, n_l, n_v, alpha, table)",
       .directions = {over("value", kWhole, "1.0 + 0.0 * alpha", "1", kBeforehand)},
       .transposed = {"straight", "grazing", "n_l", "n_v", "alpha", "table"}},
      {.name = "material.turquin",
       .part = {},
       .result = "vec3",
       .operands = join({{vectors("straight", 0, 1, 1e-3), floats("n_v", 1e-3, 1, 1e-3), alpha()}, table}),
       .value = "material.turquin(straight, n_v, alpha, table)",
       .directions = {relative("value", kWhole, kBeforehand)},
       .transposed = {"straight", "n_v", "alpha", "table"}},
  };
}

std::vector<Function> lamps() {
  const Operand lamp = vectors("lamp", -100, 100, 1e-4), at = vectors("at", -100, 100, 1e-4);
  const Operand color = vectors("color", 1e-3, 100);
  // The cone's border is a quotient of a difference of cosines of the rounding of the axis and the way, over that of
  // the two angles.
  return {
      {.name = "light.spot",
       .part = {},
       .result = "vec3",
       .operands = join({{lamp, at, color}, unit("axis")}),
       .value = "light.spot(lamp, axis, at, color, 10.0, 60.0).color",
       .directions = all_conditioned(32 * u, 64 * u, {"lamp", "at", "color", "axis"})},
      {.name = "light.sphere",
       .part = "color",
       .result = "vec3",
       .operands = {lamp, floats("radius", 1e-3, 10, 1e-3), at, color},
       .value = "light.sphere(lamp, radius, at, color).color",
       .directions = all_conditioned(8 * u, 16 * u, {"lamp", "radius", "at", "color"})},
      {.name = "light.sphere",
       .part = "size",
       .result = "float",
       .operands = {lamp, floats("radius", 1e-3, 10, 1e-3), at},
       .value = "light.sphere(lamp, radius, at).size",
       .directions = all_conditioned(16 * u, 32 * u, {"lamp", "radius", "at"})},
      {.name = "light.fade",
       .part = {},
       .result = "float",
       .operands = {lamp, at, floats("range", 1e-2, 300)},
       .value = "light.fade(lamp, at, range)",
       .directions = all_conditioned(16 * u, 32 * u, {"lamp", "at", "range"})},
      {.name = "light.intensity",
       .part = {},
       .result = "float",
       .operands = {floats("flux", 0, 1e6, 1e-6)},
       .value = "light.intensity(flux)",
       .directions = {relative("value", 4 * u, kFew), relative("flux", 4 * u, kFew)}},
      {.name = "light.ball_intensity",
       .part = {},
       .result = "vec3",
       .operands = {vectors("radiance", 0, 1e4, 1e-4), floats("radius", 1e-4, 100)},
       .value = "light.ball_intensity(radiance, radius)",
       .directions = {relative("value", 4 * u, kFew), relative("radiance", 4 * u, kFew),
                      relative("radius", 8 * u, kFew)}},
  };
}

std::vector<Function> tones() {
  const Operand color = vectors("color", 0, 100, 1e-3);
  return {
      {.name = "tone.exposed",
       .part = {},
       .result = "vec3",
       .operands = {color, floats("stops", -8, 8, 1e-3)},
       .value = "tone.exposed(color, stops)",
       .directions = all_conditioned(8 * u, 16 * u, {"color", "stops"})},
      {.name = "tone.reinhard",
       .part = {},
       .result = "vec3",
       .operands = {color},
       .value = "tone.reinhard(color)",
       .directions = {relative("value", 8 * u, kFew),
                      over("color", 16 * u, "length(g) / (1.0 + max(max(color.x, color.y), color.z))",
                           "|adjoint| / (1 + the largest)", "two terms that cancel for the largest")}},
      {.name = "tone.neutral",
       .part = {},
       .result = "vec3",
       .operands = {color},
       .value = "tone.neutral(color)",
       .directions = {over("value", 16 * u, "1.0 + abs(y)", "1 + |y|", "the differences from the curve's start"),
                      conditioned("color", 256 * u, "the same, over the slope of the curve's end")}},
  };
}

}  // namespace

std::vector<Function> material_functions() {
  std::vector<Function> all = terms();
  for (auto&& part : {layers(), lit_surfaces(), energies(), lamps(), tones()})
    all.insert(all.end(), part.begin(), part.end());
  return all;
}

}  // namespace dr::accuracy::library
