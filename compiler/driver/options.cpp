// SPDX-License-Identifier: Apache-2.0
#include "compiler/driver/options.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <limits>

namespace dr::driver {

const std::vector<Choice>& choices() {
  static const std::vector<Choice> kChoices = {
      {"profile", "device to compile for: a built-in name or a JSON file", &Options::profile, {}},
      {"lower", "where maps run", &Options::lower, {"auto", "fragment", "compute"}},
      {"raster", "how raster runs", &Options::raster, {"auto", "hardware", "compute"}},
      {"scatter", "how scattered values are summed", &Options::scatter, {"auto", "exact", "rows", "atomic"}},
      {"float",
       "floats: our own functions, the same bits however ops are packed, or the driver's, faster",
       &Options::float_profile,
       {"strict", "native"}},
      {"pack", "how ops share passes", &Options::pack, {"fused", "naive"}},
  };
  return kChoices;
}

const std::vector<std::string>& ablations() {
  static const std::vector<std::string> kParts = {"substages", "stages",  "remat",   "cache",
                                                  "blocks",    "guesses", "emptying"};
  return kParts;
}

std::optional<std::vector<double>> known_value(const std::string& text) {
  std::vector<double> numbers;
  for (const char *at = text.data(), *const end = at + text.size();;) {
    const auto [next, error] = std::from_chars(at, end, numbers.emplace_back());
    if (error != std::errc{} || !(std::fabs(numbers.back()) <= std::numeric_limits<float>::max())) return std::nullopt;
    if (next == end) return numbers;
    if (*next != ',') return std::nullopt;
    at = next + 1;
  }
}

std::string command_line(const Options& options) {
  const Options plain;
  std::string out;
  for (const Choice& choice : choices())
    if (options.*choice.value != plain.*choice.value) out += " --" + choice.name + "=" + options.*choice.value;
  for (const std::string& part : options.ablate)
    out += (std::ranges::find(ablations(), part) != ablations().end() ? " --ablate=" : " --no-skip=") + part;
  if (options.plain_gradients) out += " --plain-gradients";
  for (const auto& [name, numbers] : options.known) {
    out += " --known=" + name;
    for (size_t k = 0; k < numbers.size(); ++k) {
      char text[32];
      std::snprintf(text, sizeof text, "%c%.17g", k == 0 ? '=' : ',', numbers[k]);
      out += text;
    }
  }
  return out;
}

}  // namespace dr::driver
