// SPDX-License-Identifier: Apache-2.0
#include "runtime/drun/mesh_material.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <iterator>
#include <limits>
#include <optional>
#include <string_view>

#include "runtime/drun/target.h"

namespace dr::drun {

using io::Array;

namespace {

constexpr const char* kParts =
    "base_color, metallic, roughness, emissive, base_color_texture, metallic_texture, roughness_texture, "
    "metallic_roughness_texture, normal_texture, occlusion_texture, emissive_texture";

// A picture of three numbers, each of one picture or the same everywhere.
Array channels(const std::optional<Array>& red, const std::optional<Array>& green, const std::optional<Array>& blue) {
  const Array& size = red ? *red : green ? *green : *blue;
  std::vector<float> out(static_cast<size_t>(size.size()) * 3, 1);
  const std::optional<Array>* of[] = {&red, &green, &blue};
  for (size_t c = 0; c < 3; ++c)
    if (*of[c]) {
      const auto from = (*of[c])->as<float>();
      for (size_t k = 0; k < from.size(); ++k) out[3 * k + c] = from[k];
    }
  return Array::from_floats(out, 3, size.width, size.height, size.layers);
}

}  // namespace

int MeshMaterial::components_of(const std::string& file, const std::string& part) {
  if ((std::string(", ") + kParts + ", ").find(", " + part + ", ") == std::string::npos)
    throw Mistake{"--mesh " + file + ": a material has no '" + part + "', it has " + kParts};
  constexpr std::string_view kScalars[] = {"metallic", "roughness", "metallic_texture", "roughness_texture",
                                           "occlusion_texture"};
  return std::ranges::find(kScalars, part) != std::end(kScalars) ? 1 : 3;
}

MeshMaterial::MeshMaterial(const std::string& file, const std::map<std::string, std::string>& parts,
                           const Values& values) {
  std::map<std::string, std::string> left = parts;
  const auto take = [&](const char* part, int components) -> std::optional<Array> {
    const auto found = left.find(part);
    if (found == left.end()) return std::nullopt;
    Array a = values(found->second, components);
    left.erase(found);
    return a;
  };
  // A fit may leave a little more or less than a material takes, and its file may be all that stays: as in a picture,
  // the nearest number is written. A NaN or Inf is refused.
  const auto factor = [&](const char* part, int components, double high = 1) -> std::optional<std::vector<double>> {
    const auto name = left.count(part) != 0 ? left.at(part) : "";
    const auto a = take(part, components);
    if (!a) return std::nullopt;
    if (a->size() != 1)
      throw Mistake{"--mesh " + file + ": '" + name + "' is a picture, expected one value for " + part +
                    "; its picture is " + part + "_texture"};
    std::vector<double> numbers = a->to_doubles();
    for (double& number : numbers) {
      const double nearest = std::clamp(number, 0.0, high);
      if (nearest == number || !std::isfinite(number)) continue;
      std::fprintf(stderr, "drun: warning: --mesh %s: '%s' is %g, out of the range of %s: %g is written\n",
                   file.c_str(), name.c_str(), number, part, nearest);
      number = nearest;
    }
    return numbers;
  };
  const auto texture = [&](const char* part) -> const Array* {
    auto a = take(part, 3);
    return a ? keep(*std::move(a)) : nullptr;
  };
  texture_ = texture("base_color_texture");
  material_.metallic_roughness = texture("metallic_roughness_texture");
  const auto metallic = take("metallic_texture", 1), roughness = take("roughness_texture", 1);
  if (metallic || roughness) {
    if (material_.metallic_roughness)
      throw Mistake{"--mesh " + file +
                    ": 'metallic_roughness_texture' holds what 'metallic_texture' and 'roughness_texture' do"};
    if (metallic && roughness && (metallic->width != roughness->width || metallic->height != roughness->height))
      throw Mistake{"--mesh " + file +
                    ": the metallic and the roughness texture are one picture in the file, and of "
                    "unlike size"};
    material_.metallic_roughness = keep(channels(std::nullopt, roughness, metallic));
  }
  material_.normal = texture("normal_texture");
  if (const auto occlusion = take("occlusion_texture", 1))
    material_.occlusion = keep(channels(occlusion, occlusion, occlusion));
  material_.emission = texture("emissive_texture");
  // A texture alone is what the material is: factors are 1 then. What is missing altogether is matt.
  if (const auto f = factor("base_color", 3)) std::ranges::copy(*f, material_.base_color.begin());
  material_.metallic = material_.metallic_roughness != nullptr && (metallic || !roughness) ? 1 : 0;
  if (const auto f = factor("metallic", 1)) material_.metallic = (*f)[0];
  if (const auto f = factor("roughness", 1)) material_.roughness = (*f)[0];
  if (material_.emission) material_.emissive = {1, 1, 1};
  if (const auto f = factor("emissive", 3, std::numeric_limits<double>::max()))
    std::ranges::copy(*f, material_.emissive.begin());
  if (!left.empty()) components_of(file, left.begin()->first);
}

void MeshMaterial::show(io::MeshView& view) const {
  view.texture = texture_;
  view.material = material_;
}

}  // namespace dr::drun
