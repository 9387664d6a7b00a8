// SPDX-License-Identifier: Apache-2.0
#include "runtime/watch/picture.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>

namespace dr::watch {
namespace {

double number_at(const io::Array& array, size_t index) {
  switch (array.kind) {
    case io::ElementKind::Float32: return array.as<float>()[index];
    case io::ElementKind::Float64: return array.as<double>()[index];
    case io::ElementKind::Int32: return array.as<int32_t>()[index];
    case io::ElementKind::UInt32: return array.as<uint32_t>()[index];
    case io::ElementKind::Bool: return array.bytes[index] != std::byte{0} ? 1 : 0;
  }
  return 0;
}

// From 0 to 1, by a table: a picture has many pixels and a screen few shades.
unsigned char curve(double linear) {
  constexpr size_t kSteps = 4096;
  static const auto kTable = [] {
    std::array<unsigned char, kSteps + 1> table{};
    for (size_t i = 0; i <= kSteps; ++i) {
      const double x = static_cast<double>(i) / kSteps;
      const double y = x <= 0.0031308 ? 12.92 * x : 1.055 * std::pow(x, 1 / 2.4) - 0.055;
      table[i] = static_cast<unsigned char>(std::lround(255 * y));
    }
    return table;
  }();
  return kTable[static_cast<size_t>(std::clamp(linear, 0.0, 1.0) * kSteps + 0.5)];
}

}  // namespace

bool is_picture(const io::Array& array) { return array.components <= 4 && array.width > 1 && array.height > 1; }

Picture picture_of(const io::Array& array, int layer, int most) {
  Picture out;
  const int64_t longest = std::max(array.width, array.height);
  const int64_t every = (longest + most - 1) / most;
  out.width = static_cast<int>((array.width + every - 1) / every);
  out.height = static_cast<int>((array.height + every - 1) / every);
  out.layers = static_cast<int>(array.layers);
  out.layer = std::clamp(layer, 0, out.layers - 1);
  const auto components = static_cast<size_t>(array.components);
  const bool is_data = components < 3;
  std::vector<double> numbers;
  numbers.reserve(static_cast<size_t>(out.width) * static_cast<size_t>(out.height) * components);
  double least = 0, greatest = 1;
  for (int64_t y = 0; y < array.height; y += every) {
    for (int64_t x = 0; x < array.width; x += every) {
      const auto element = static_cast<size_t>((out.layer * array.height + y) * array.width + x);
      for (size_t c = 0; c < components; ++c) {
        const double number = number_at(array, element * components + c);
        if (is_data && std::isfinite(number)) least = std::min(least, number), greatest = std::max(greatest, number);
        numbers.push_back(number);
      }
    }
  }
  if (least < 0 || greatest > 1) {
    char note[80];
    std::snprintf(note, sizeof note, "black %.4g, white %.4g", least, greatest);
    out.note = note;
  }
  const double scale = 1 / (greatest - least);
  for (size_t p = 0; p < numbers.size(); p += components) {
    std::array<unsigned char, 4> pixel{0, 0, 0, 255};
    bool bad = false;
    for (size_t c = 0; c < components; ++c) {
      const double number = numbers[p + c];
      bad = bad || !std::isfinite(number);
      if (bad) break;
      const double shade = std::clamp((number - least) * scale, 0.0, 1.0);
      pixel[c] = is_data || c == 3 ? static_cast<unsigned char>(std::lround(255 * shade)) : curve(number);
    }
    if (components == 1) pixel[1] = pixel[2] = pixel[0];
    if (bad) pixel = {255, 0, 255, 255};  // what is NaN or Inf is to be seen
    out.pixels.append(pixel.begin(), pixel.end());
  }
  return out;
}

}  // namespace dr::watch
