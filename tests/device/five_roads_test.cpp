// SPDX-License-Identifier: Apache-2.0
// One program on every road: the evaluator, and on each device fragment passes with hardware raster, and compute passes
// with compute raster, fused and naive, and as many subpasses as ops. Lowerings on one device must agree bit for bit;
// the device must agree with the evaluator that is given the device's faces and tags.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <optional>
#include <sstream>

#include "compiler/backend/bundle/entries.h"
#include "runtime/jit/jit.h"
#include "runtime/jit/reference_program.h"
#include "runtime/runtime.h"
#include "tests/catch.h"
#include "tests/device/compile.h"
#include "tests/device/devices.h"

using namespace dr;
using io::Array;
using test::compile;
using test::must;

namespace {

constexpr double kImageTolerance = 1e-5;     // absolute
constexpr double kGradientTolerance = 1e-4;  // relative L2
// Of the profile `native`: coverage is a sigmoid within (6 + 2|x|) 2^-23, |x| <= 7 inside the band; gradients sum its
// products.
constexpr double kNativeImageTolerance = 1e-4, kNativeGradientTolerance = 1e-3;
constexpr int kSize = 48;

const std::filesystem::path kExamples = std::filesystem::path(DR_SOURCE_DIR) / "docs/examples";

// The example, with a step that shows its gradients.
std::string write_program() {
  std::ifstream file(kExamples / "fit_sphere.dr");
  std::stringstream text;
  text << file.rdbuf();
  const auto path = std::filesystem::path(DR_BUILD_DIR) / "five_roads.dr";
  std::ofstream(path) << text.str()
                      << "\nstep probe {\n  output alpha, picture, total, gradient = grad(total, position), "
                         "gain_gradient = grad(photo_loss, gain);\n}\n";
  return path.string();
}

// A disc as target: any silhouette will do, as long as it is not the sphere's own.
Array target(double radius) {
  std::vector<float> values;
  for (int l = 0; l < 2; ++l)
    for (int y = 0; y < kSize; ++y)
      for (int x = 0; x < kSize; ++x) {
        const double d = std::hypot(x + 0.5 - kSize * 0.52, y + 0.5 - kSize * 0.47) - radius * kSize;
        values.push_back(static_cast<float>(1 / (1 + std::exp(d * 2))));
      }
  return Array::from_floats(values, 1, kSize, kSize, 2);
}

template <class P>
void bind_inputs(P& program) {
  must(program.bind("position", must(io::load_binding((kExamples / "sphere.obj").string() + ":position", 3))));
  must(program.bind("face", must(io::load_binding((kExamples / "sphere.obj").string() + ":indices", 3))));
  must(program.bind("view", must(io::load_binding((kExamples / "views.json").string(), 16))));
  must(program.bind("target", target(0.23)));
  must(program.bind("photo", target(0.2)));
}

const char* const kOutputs[] = {"alpha", "picture", "total", "gradient", "gain_gradient"};

std::vector<std::vector<Array>> rasters(const jit::ReferenceProgram& program) { return program.rasters("probe"); }
std::vector<std::vector<Array>> rasters(runtime::Program& program) { return must(program.rasters("probe")); }

struct Answer {
  std::map<std::string, Array> outputs;     // of the probe
  std::map<std::string, Array> after;       // leaves and outputs after the fitting steps
  std::vector<std::vector<Array>> rasters;  // of the probe
};

template <class P>
Answer run(P& program) {
  Answer answer;
  bind_inputs(program);
  must(program.run("probe"));
  answer.rasters = rasters(program);
  for (const char* name : kOutputs) answer.outputs.emplace(name, must(program.output("probe", name)));
  must(program.run("fit_shape", 3));
  must(program.run("fit_gain", 2));
  answer.after.emplace("position", must(program.leaf("position")));
  answer.after.emplace("gain", must(program.leaf("gain")));
  answer.after.emplace("alpha", must(program.output("fit_shape", "alpha")));
  answer.after.emplace("picture", must(program.output("fit_gain", "picture")));
  return answer;
}

bool same_bits(const Array& a, const Array& b) { return a.kind == b.kind && a.bytes == b.bytes; }

// Of one face, or of some face on the road that asks for presence alone.
bool same_face(double a, double b) {
  const bool some = a == bundle::kSomeFace || b == bundle::kSomeFace;
  return a == b || (some && a >= 0 && b >= 0);
}

bool same_faces(const Array& a, const Array& b) {
  const auto x = a.to_doubles(), y = b.to_doubles();
  return a.kind == b.kind && std::ranges::equal(x, y, same_face);
}

double max_difference(const Array& a, const Array& b) {
  const auto x = a.to_doubles(), y = b.to_doubles();
  REQUIRE(x.size() == y.size());
  double most = 0;
  for (size_t k = 0; k < x.size(); ++k)
    most = std::max(most, std::isnan(x[k] - y[k]) ? INFINITY : std::fabs(x[k] - y[k]));
  return most;
}

double relative_l2(const Array& a, const Array& b) {
  const auto x = a.to_doubles(), y = b.to_doubles();
  REQUIRE(x.size() == y.size());
  double difference = 0, size = 0;
  for (size_t k = 0; k < x.size(); ++k) {
    difference += (x[k] - y[k]) * (x[k] - y[k]);
    size += y[k] * y[k];
  }
  REQUIRE(size > 0);
  return std::sqrt(difference / size);
}

}  // namespace

TEST_CASE("one program gives one answer on every road") {
  const std::string path = write_program();
  const auto all = test::devices();
  jit::Options options;
  options.profile = "lavapipe";
  const auto any_bundle = compile(path, options);
  auto free_reference = must(jit::ReferenceProgram::load(any_bundle));
  const Answer truth = run(free_reference);
  const auto& true_rasters = truth.rasters;

  for (const auto& [name, device] : all) {
    struct Road {
      const char* name;
      const char* lower;
      const char* raster;
      const char* pack;
      std::vector<std::string> ablate = {};
    };
    const Road roads[] = {{"fragment, hardware raster", "fragment", "hardware", "fused"},
                          {"compute, compute raster", "compute", "compute", "fused"},
                          {"naive compute, compute raster", "compute", "compute", "naive"},
                          {"naive fragment, hardware raster", "fragment", "hardware", "naive"},
                          {"each op a subpass", "fragment", "hardware", "fused", {"substages", "remat"}}};
    std::optional<Answer> first;
    for (const Road& road : roads) {
      INFO(name << ", " << road.name);
      options.profile = road.ablate.empty() ? name : test::profile_of_subpasses(name);
      options.lower = road.lower;
      options.raster = road.raster;
      options.pack = road.pack;
      options.ablate = road.ablate;
      auto program = must(runtime::Program::load(device, compile(path, options)));
      Answer answer = run(program);
      for (const std::string& message : device.validation_messages()) FAIL("validation: " << message);

      if (first) {
        for (const auto& [output, array] : answer.outputs) {
          INFO(output << " differs by " << max_difference(array, first->outputs.at(output)));
          CHECK(same_bits(array, first->outputs.at(output)));
        }
        for (const auto& [leaf, array] : answer.after) {
          INFO(leaf << " after the steps differs by " << max_difference(array, first->after.at(leaf)));
          CHECK(same_bits(array, first->after.at(leaf)));
        }
        REQUIRE(answer.rasters.size() == first->rasters.size());
        for (size_t r = 0; r < answer.rasters.size(); ++r)
          for (size_t k = 0; k < answer.rasters[r].size(); ++k) {
            const Array &found = answer.rasters[r][k], &others = first->rasters[r][k];
            CHECK((k % 2 == 0 ? same_faces(found, others) : same_bits(found, others)));
          }
        continue;
      }

      // Against the evaluator, given what this device saw.
      auto frozen = must(jit::ReferenceProgram::load(any_bundle));
      bind_inputs(frozen);
      must(frozen.freeze("probe", answer.rasters));
      must(frozen.run("probe"));
      const double alpha = max_difference(answer.outputs.at("alpha"), must(frozen.output("probe", "alpha")));
      const double picture = max_difference(answer.outputs.at("picture"), must(frozen.output("probe", "picture")));
      const double gradient = relative_l2(answer.outputs.at("gradient"), must(frozen.output("probe", "gradient")));
      const double gain =
          relative_l2(answer.outputs.at("gain_gradient"), must(frozen.output("probe", "gain_gradient")));
      CHECK(alpha <= kImageTolerance);
      CHECK(picture <= kImageTolerance);
      CHECK(gradient <= kGradientTolerance);
      CHECK(gain <= kGradientTolerance);

      size_t pixels = 0, faces = 0, tags = 0;
      for (size_t r = 0; r < answer.rasters.size(); ++r)
        for (size_t k = 0; k + 1 < answer.rasters[r].size(); k += 2) {
          const auto f = answer.rasters[r][k].to_doubles(), ft = true_rasters[r][k].to_doubles();
          const auto t = answer.rasters[r][k + 1].to_doubles(), tt = true_rasters[r][k + 1].to_doubles();
          for (size_t i = 0; i < f.size(); ++i) {
            ++pixels;
            faces += !same_face(f[i], ft[i]);
            tags += f[i] == ft[i] && t[i] != tt[i];
          }
        }
      std::printf(
          "%-12s against the evaluator: alpha %.2g, picture %.2g, gradient %.2g, gain gradient %.2g; of %zu entries "
          "%.3g%% have another face, %.3g%% another tag\n",
          name.c_str(), alpha, picture, gradient, gain, pixels,
          100.0 * static_cast<double>(faces) / static_cast<double>(pixels),
          100.0 * static_cast<double>(tags) / static_cast<double>(pixels));
      // A discrete choice may fall otherwise where rounding decides, and only there.
      CHECK(faces + tags < pixels / 100);
      first = std::move(answer);
    }
  }
  CHECK(truth.outputs.at("gradient").size() > 0);
}

TEST_CASE("the driver's floats are as close as their built-ins") {
  const std::string path = write_program();
  for (const auto& [name, device] : test::devices()) {
    for (const char* lower : {"fragment", "compute"}) {
      INFO(name << ", " << lower);
      jit::Options options;
      options.profile = name;
      options.lower = lower;
      options.raster = lower == std::string("fragment") ? "hardware" : "compute";
      options.float_profile = "native";
      const auto bundle = compile(path, options);
      auto program = must(runtime::Program::load(device, bundle));
      auto frozen = must(jit::ReferenceProgram::load(bundle));
      bind_inputs(program);
      bind_inputs(frozen);
      must(program.run("probe"));
      must(frozen.freeze("probe", must(program.rasters("probe"))));
      must(frozen.run("probe"));
      double worst[2] = {0, 0};
      for (const char* output : {"alpha", "picture"})
        worst[0] = std::max(
            worst[0], max_difference(must(program.output("probe", output)), must(frozen.output("probe", output))));
      for (const char* output : {"gradient", "gain_gradient"})
        worst[1] = std::max(worst[1],
                            relative_l2(must(program.output("probe", output)), must(frozen.output("probe", output))));
      std::printf("%-12s %s, native floats: image %.2g, gradients %.2g\n", name.c_str(), lower, worst[0], worst[1]);
      CHECK(worst[0] <= kNativeImageTolerance);
      CHECK(worst[1] <= kNativeGradientTolerance);
    }
    for (const std::string& message : device.validation_messages()) FAIL("validation: " << message);
  }
}

TEST_CASE("a step gives the same bits every time") {
  const std::string path = write_program();
  for (const auto& [name, device] : test::devices()) {
    INFO(name);
    jit::Options options;
    options.profile = name;
    const auto bundle = compile(path, options);
    std::optional<Answer> first;
    for (int k = 0; k < 5; ++k) {
      auto program = must(runtime::Program::load(device, bundle));
      Answer answer = run(program);
      if (!first) {
        first = std::move(answer);
        continue;
      }
      for (const auto& [output, array] : answer.outputs) CHECK(same_bits(array, first->outputs.at(output)));
      for (const auto& [leaf, array] : answer.after) CHECK(same_bits(array, first->after.at(leaf)));
    }
    for (const std::string& message : device.validation_messages()) FAIL("validation: " << message);
  }
}
