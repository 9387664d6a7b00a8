// SPDX-License-Identifier: Apache-2.0
// Functions of the library and their gradients (special_values.dr) on zeros, subnormals, equal and opposite numbers,
// tiny and large ones: no NaN and no Inf comes out where the float64 evaluator has a number well inside float32's
// range. On the evaluator in float32, then on devices. DR_STRESS_ROUNDS sets how many sets of operands are drawn.
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <numbers>
#include <random>
#include <sstream>

#include "compiler/backend/compile.h"
#include "compiler/backend/spirv/shader_cache.h"
#include "compiler/lower/lower.h"
#include "compiler/passes/passes.h"
#include "dsl/diagnostic/diagnostic.h"
#include "runtime/runtime.h"
#include "tests/catch.h"
#include "tests/device/devices.h"
#include "tests/gradient/build.h"

using namespace dr;
using gradient_test::Images;
using reference::Image;
using test::must;

namespace {

constexpr int64_t kElements = 256;
// Sizes of operands. Subnormal ones are left to accuracy_test: what the library divides by their lengths, normals and
// frames, leaves float32's range by right.
constexpr double kSpecial[] = {
    0,   1e-18, 1e-10, 1e-6, 1e-3, 0.5, 1 - 0x1p-24, 1, 1 + 0x1p-23, 1.5, 2.0, std::numbers::pi / 2, std::numbers::pi,
    3.0, 90.0,  100.0, 1e4,  1e6};
// Beyond this a float32 product on the way may have left the range.
constexpr double kWellInside = 0x1p60;

ir::Graph graph_of(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::stringstream text;
  text << file.rdbuf();
  dsl::SourceManager sources;
  dsl::DiagnosticList diagnostics;
  const auto graph = lower::lower(sources, sources.add(path, text.str()), {}, diagnostics);
  if (!graph) FAIL(dsl::format(diagnostics, sources));
  return passes::run_passes(*graph, passes::default_passes());
}

Images operands(const ir::Graph& graph, uint64_t seed) {
  std::mt19937_64 random(seed);
  Images all;
  for (const ir::Leaf& leaf : graph.leaves) {
    const int64_t width = leaf.extent.w.evaluate({}).value_or(kElements);  // the seed of std.random is one number
    Image image = reference::zeros(leaf.type, width, 1, 1);
    const auto components = static_cast<size_t>(leaf.type.components()), n = static_cast<size_t>(width);
    for (size_t i = 0; i < n; ++i) {
      double x = 0;
      for (size_t c = 0; c < components; ++c) {
        if (leaf.type.scalar == ir::Scalar::Uint) {
          x = static_cast<double>(static_cast<uint32_t>(random()) >> (random() % 32));
        } else if (c == 0 || random() % 2 == 0) {  // else the component before: diagonals
          x = kSpecial[random() % std::size(kSpecial)] * (random() % 2 == 0 ? 1 : -1);
        }
        image.data[c * n + i] = static_cast<double>(static_cast<float>(x));
      }
    }
    // Every fourth element equals that of the leaf before: points that coincide, directions that are parallel.
    for (const auto& [name, other] : all) {
      if (other.type != leaf.type || other.width != width) continue;
      for (size_t c = 0; c < components; ++c)
        for (size_t i = 0; i < n; i += 4) image.data[c * n + i] = other.data[c * n + i];
    }
    all.emplace(leaf.name, std::move(image));
  }
  return all;
}

Images evaluate(const ir::Graph& graph, const Images& data, const std::string& step, bool float32) {
  reference::Session session(graph);
  gradient_test::bind_leaves(session, data);
  reference::Options options;
  options.float32 = float32;
  auto result = session.run(step, options);
  if (const auto* error = std::get_if<reference::EvalError>(&result)) FAIL(step << ": " << error->message);
  return std::move(std::get<reference::StepResult>(result).outputs);
}

// Subnormal numbers as devices may take them.
Images flushed(Images data) {
  for (auto& [name, image] : data)
    for (double& x : image.data)
      if (image.type.is_float() && std::abs(x) < 0x1p-126) x = 0;
  return data;
}

// Elements that are not finite where they must be: reported by output, with the operands of the first.
void check(const std::string& where, const std::vector<double>& found, const Image& expected, const Image& of_flushed,
           const Images& data) {
  size_t bad = 0, first = 0;
  REQUIRE(found.size() == expected.data.size());
  for (size_t i = 0; i < found.size(); ++i) {
    if (std::isfinite(found[i])) continue;
    if (!(std::abs(expected.data[i]) < kWellInside) || !(std::abs(of_flushed.data[i]) < kWellInside)) continue;
    if (bad++ == 0) first = i;
  }
  const auto n = static_cast<size_t>(expected.count());
  std::ostringstream at;
  if (bad > 0 && n == static_cast<size_t>(kElements)) {
    at.precision(9);
    for (const auto& [name, image] : data) {
      at << "\n  " << name << " =";
      for (size_t k = first % n; k < image.data.size(); k += n) at << " " << image.data[k];
    }
  }
  INFO(where << ": " << bad << " of " << found.size() << " not finite, the first is component " << first / n
             << " of element " << first % n << ", expected " << expected.data[first] << at.str());
  CHECK(bad == 0);
}

}  // namespace

TEST_CASE("the library gives numbers for special values") {
  const char* wanted = std::getenv("DR_STRESS_ROUNDS");
  const uint64_t rounds = wanted != nullptr ? std::strtoull(wanted, nullptr, 10) : 2;
  const ir::Graph graph = graph_of(std::string(DR_SOURCE_DIR) + "/tests/stress/special_values.dr");
  const auto devices = test::devices();
  std::vector<runtime::Program> programs;
  for (const auto& [name, device] : devices) {
    const auto profile = target::load_profile(name);
    backend::CompileOptions options;
    options.cache_folder = backend::default_cache_folder();
    auto compiled = backend::compile(graph, std::get<target::Profile>(profile), options);
    if (const auto* problem = std::get_if<backend::Limit>(&compiled)) FAIL(problem->text);
    programs.push_back(
        must(runtime::Program::load(device, bundle::write(std::get<backend::Compiled>(compiled).bundle))));
  }
  size_t numbers = 0;
  for (uint64_t round = 0; round < rounds; ++round) {
    const Images data = operands(graph, round);
    for (runtime::Program& program : programs) {
      for (const auto& leaf : program.leaves()) {
        const Image& image = data.at(leaf.name);
        const auto components = static_cast<size_t>(leaf.components), n = static_cast<size_t>(image.width);
        std::vector<double> values(image.data.size());
        for (size_t c = 0; c < components; ++c)
          for (size_t i = 0; i < n; ++i) values[i * components + c] = image.data[c * n + i];
        must(program.bind(leaf.name, io::Array::from_doubles(values, leaf.components)));
      }
    }
    for (const ir::Step& step : graph.steps) {
      const Images expected = evaluate(graph, data, step.name, false),
                   of_flushed = evaluate(graph, flushed(data), step.name, false),
                   single = evaluate(graph, data, step.name, true);
      for (runtime::Program& program : programs) must(program.run(step.name));
      for (const auto& [output, image] : expected) {
        if (!image.type.is_float()) continue;
        const std::string what = "round " + std::to_string(round) + ", " + step.name + "." + output;
        numbers += image.data.size();
        check(what + " in float32", single.at(output).data, image, of_flushed.at(output), data);
        for (size_t k = 0; k < programs.size(); ++k) {
          const auto found = must(programs[k].output(step.name, output)).to_doubles();
          std::vector<double> planes(found.size());
          const auto n = static_cast<size_t>(image.count()), components = found.size() / n;
          for (size_t c = 0; c < components; ++c)
            for (size_t i = 0; i < n; ++i) planes[c * n + i] = found[i * components + c];
          check(what + " on " + devices[k].name, planes, image, of_flushed.at(output), data);
        }
      }
    }
  }
  for (const auto& [name, device] : devices)
    for (const std::string& message : device.validation_messages()) FAIL(name << " validation: " << message);
  std::printf("%zu numbers, the evaluator in float32 and %zu devices\n", numbers, programs.size());
}
