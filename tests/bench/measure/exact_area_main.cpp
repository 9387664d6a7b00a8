// SPDX-License-Identifier: Apache-2.0
// bench_exact_area POINTS FACES WIDTH HEIGHT OUT [--depth Z] [--color C] [--background B] [--adjoint A] [--differences
// COUNT] Of a mesh in pixels: OUT.picture.npy, the exact mean of each pixel, and with an adjoint OUT.gradient.npy, that
// of sum(A * picture) to each point. --differences compares COUNT points' gradients with central differences. See
// exact_area.h.
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <string>

#include "compiler/io/array/array.h"
#include "tests/bench/measure/exact_area.h"
#include "tests/must.h"

using namespace dr;
using benchmark::must;

namespace {

void differences(benchmark::ExactArea& area, std::span<const double> adjoint,
                 const std::vector<benchmark::Point>& gradient, int64_t count) {
  // Points that move something, evenly chosen.
  std::vector<size_t> moving;
  for (size_t i = 0; i < gradient.size(); ++i)
    if (gradient[i].x != 0 || gradient[i].y != 0) moving.push_back(i);
  const auto n = std::min(static_cast<size_t>(count), moving.size());
  for (const double step : {1e-3, 1e-4, 1e-5, 1e-6}) {
    double apart = 0, size = 0, worst = 0;
    for (size_t k = 0; k < n; ++k) {
      const size_t i = moving[k * moving.size() / n];
      const benchmark::Point found = area.difference(adjoint, i, step), expected = gradient[i];
      const double d = std::hypot(found.x - expected.x, found.y - expected.y);
      apart += d * d, size += expected.x * expected.x + expected.y * expected.y, worst = std::max(worst, d);
    }
    std::printf("differences of %zu points, step %g: %.3g of the gradient's length, the worst off by %.3g\n", n, step,
                std::sqrt(apart / size), worst);
  }
}

}  // namespace

int main(int argc, char** argv) {
  std::map<std::string, std::string> option;
  std::vector<std::string> words;
  for (int i = 1; i < argc; ++i)
    if (const std::string word = argv[i]; word.starts_with("--") && i + 1 < argc)
      option[word.substr(2)] = argv[++i];
    else
      words.push_back(word);
  if (words.size() != 5) {
    std::fprintf(stderr,
                 "usage: bench_exact_area POINTS FACES WIDTH HEIGHT OUT [--depth Z] [--color C] [--background B] "
                 "[--adjoint A] [--differences COUNT]\n");
    return 2;
  }
  const auto numbers = [](const std::string& file, int components) {
    return must(io::load_binding(file, components)).to_doubles();
  };
  benchmark::Scene scene;
  const auto points = numbers(words[0], 2), faces = numbers(words[1], 3);
  for (size_t i = 0; i + 1 < points.size(); i += 2) scene.points.push_back({points[i], points[i + 1]});
  for (size_t i = 0; i + 2 < faces.size(); i += 3)
    scene.faces.push_back(
        {static_cast<int32_t>(faces[i]), static_cast<int32_t>(faces[i + 1]), static_cast<int32_t>(faces[i + 2])});
  scene.width = std::atoi(words[2].c_str()), scene.height = std::atoi(words[3].c_str());
  if (option.contains("depth")) scene.depth = numbers(option["depth"], 1);
  if (option.contains("color")) scene.color = numbers(option["color"], 1);
  if (option.contains("background")) scene.background = std::atof(option["background"].c_str());
  const int width = scene.width, height = scene.height;
  benchmark::ExactArea area(std::move(scene));
  must(io::save_array(words[4] + ".picture.npy", io::Array::from_doubles(area.picture(), 1, width, height)));
  if (!option.contains("adjoint")) return 0;
  const auto adjoint = numbers(option["adjoint"], 1);
  const auto gradient = area.gradient(adjoint);
  std::vector<double> flat;
  for (const benchmark::Point& p : gradient) flat.push_back(p.x), flat.push_back(p.y);
  must(io::save_array(words[4] + ".gradient.npy", io::Array::from_doubles(flat, 2)));
  if (option.contains("differences")) differences(area, adjoint, gradient, std::atoll(option["differences"].c_str()));
  return 0;
}
