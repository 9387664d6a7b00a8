// SPDX-License-Identifier: Apache-2.0
// The example program's gradients against finite differences, with the faces and tags of the undisturbed shape held
// still.
#include <cmath>
#include <filesystem>
#include <fstream>
#include <random>
#include <sstream>

#include "compiler/io/mesh/mesh.h"
#include "compiler/lower/lower.h"
#include "compiler/passes/passes.h"
#include "compiler/reference/evaluate.h"
#include "tests/catch.h"

using namespace dr;
using reference::Image;

namespace {

constexpr int kSize = 48;
const std::filesystem::path kExamples = std::filesystem::path(DR_SOURCE_DIR) / "docs/examples";

ir::Graph example() {
  std::ifstream file(kExamples / "fit_sphere.dr");
  std::stringstream text;
  text << file.rdbuf()
       << "\nstep probe { output total, photo_loss, gradient = grad(total, position), gain_gradient = grad(photo_loss, "
          "gain); }\n";
  dsl::SourceManager sources;
  dsl::DiagnosticList diagnostics;
  const auto graph = lower::lower(sources, sources.add("fit_sphere.dr", text.str()), {}, diagnostics);
  if (!graph) FAIL(dsl::format(diagnostics, sources));
  return passes::run_passes(*graph, passes::default_passes());
}

Image image(const io::Array& array, ir::Type type) {
  Image out = reference::zeros(type, array.width, array.height, array.layers);
  const auto values = array.to_doubles();
  const auto n = static_cast<size_t>(array.components), count = static_cast<size_t>(array.size());
  for (size_t e = 0; e < count; ++e)
    for (size_t c = 0; c < n; ++c) out.data[c * count + e] = values[e * n + c];
  return out;
}

Image load(const char* source, ir::Type type) {
  const auto array = io::load_binding((kExamples / source).string(), type.components());
  if (!array) FAIL(array.error());
  return image(*array, type);
}

Image disc(double radius) {
  Image out = reference::zeros(ir::kFloat, kSize, kSize, 2);
  for (int l = 0; l < 2; ++l)
    for (int y = 0; y < kSize; ++y)
      for (int x = 0; x < kSize; ++x)
        out.at(x, y, l, 0) =
            1 / (1 + std::exp(2 * (std::hypot(x + 0.5 - kSize * 0.52, y + 0.5 - kSize * 0.47) - radius * kSize)));
  return out;
}

struct Values {
  double total, photo_loss;
  Image gradient, gain_gradient;
};

Values run(const ir::Graph& graph, const Image& position, const Image& gain, const reference::Frozen* frozen,
           reference::Frozen* record) {
  reference::Session session(graph);
  const std::pair<const char*, Image> inputs[] = {{"position", position},
                                                  {"gain", gain},
                                                  {"face", load("sphere.obj:indices", ir::vec(3, ir::Scalar::Int))},
                                                  {"view", load("views.json", {ir::Scalar::Float, 4, 4})},
                                                  {"target", disc(0.23)},
                                                  {"photo", disc(0.2)}};
  for (const auto& [name, data] : inputs)
    if (const auto problem = session.bind(name, data)) FAIL(*problem);
  reference::Options options;
  options.frozen = frozen;
  options.record = record;
  auto result = session.run("probe", options);
  if (auto* error = std::get_if<reference::EvalError>(&result)) FAIL(error->message);
  auto& out = std::get<reference::StepResult>(result).outputs;
  return {out.at("total").data[0], out.at("photo_loss").data[0], out.at("gradient"), out.at("gain_gradient")};
}

double dot(const Image& a, const Image& b) {
  double sum = 0;
  for (size_t k = 0; k < a.data.size(); ++k) sum += a.data[k] * b.data[k];
  return sum;
}

Image moved(const Image& x, const Image& direction, double h) {
  Image out = x;
  for (size_t k = 0; k < x.data.size(); ++k) out.data[k] += h * direction.data[k];
  return out;
}

}  // namespace

TEST_CASE("the example's gradients agree with finite differences, decisions frozen, to 1e-6") {
  const ir::Graph graph = example();
  const Image position = load("sphere.obj:position", ir::vec(3));
  Image gain = reference::zeros(ir::kFloat, 1, 1, 2);
  gain.data = {1.1, 0.7};
  reference::Frozen decisions;
  const Values here = run(graph, position, gain, nullptr, &decisions);
  REQUIRE(dot(here.gradient, here.gradient) > 0);

  std::mt19937_64 random(11);
  std::normal_distribution<double> normal;
  for (int trial = 0; trial < 4; ++trial) {
    Image direction = position;
    for (double& d : direction.data) d = normal(random);
    // Central differences at h and h/2, extrapolated.
    auto difference = [&](double h) {
      return (run(graph, moved(position, direction, h), gain, &decisions, nullptr).total -
              run(graph, moved(position, direction, -h), gain, &decisions, nullptr).total) /
             (2 * h);
    };
    const double h = 1e-5, expected = (4 * difference(h / 2) - difference(h)) / 3;
    const double found = dot(here.gradient, direction);
    INFO("trial " << trial << ": " << found << " against " << expected);
    CHECK(std::fabs(found - expected) <=
          1e-6 * std::sqrt(dot(here.gradient, here.gradient) * dot(direction, direction)));
    CHECK(std::fabs(found - expected) <= 1e-6 * std::fabs(expected));
  }
  Image direction = gain;
  direction.data = {0.6, -0.8};
  const double h = 1e-3;
  const double expected = (run(graph, position, moved(gain, direction, h), &decisions, nullptr).photo_loss -
                           run(graph, position, moved(gain, direction, -h), &decisions, nullptr).photo_loss) /
                          (2 * h);
  CHECK(std::fabs(dot(here.gain_gradient, direction) - expected) <= 1e-9 * std::fabs(expected));
}
