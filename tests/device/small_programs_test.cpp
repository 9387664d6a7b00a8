// SPDX-License-Identifier: Apache-2.0
// Small programs, each about one thing that went wrong or might: every device and lowering against the evaluator.
#include <cmath>
#include <filesystem>
#include <fstream>

#include "runtime/jit/jit.h"
#include "runtime/jit/reference_program.h"
#include "runtime/runtime.h"
#include "tests/catch.h"
#include "tests/device/devices.h"

using namespace dr;
using io::Array;

namespace {

struct Case {
  const char* name;
  const char* text;                // after "edition 1;"
  std::vector<const char*> steps;  // run in order; outputs of all are compared at the end
};

const Case kCases[] = {
    {"names of the user hide none of ours",
     R"(
      input a : float[W, H];
      let out = a * 2.0; let scatter = a + 1.0; let index = coord(W, H).x;
      let gather_a = a.at(coord(W, H).xy + ivec2(1, 0)); let load_a = a.at(coord(W, H).xy - ivec2(0, 1)) * gather_a;
      let y = out * sin(out) + 1.0; let at = load_a + y; let pc = at * 0.5;
      let face = scatter_add(index, scatter, W);
      step go { output out, y, at, pc, face; })",
     {"go"}},
    {"unsigned minima and maxima",
     R"(
      input a : float[W, H];
      let u = uint(a * 1000.0) + 3000000000u;
      fn low(u: uint[A, B]) -> uint { reduce(min, i in 0..A) { u.at(ivec2(i, 0)) } }
      fn high(u: uint[A, B]) -> uint { reduce(max, i in 0..A) { u.at(ivec2(i, 1)) } }
      step go { output low = low(u) / 1000u, high = high(u) / 1000u; })",
     {"go"}},
    {"a quotient by zero is infinite",
     R"(
      input a : float[W, H];
      step go { output inf = a / 0.0, both = vec2(a, -a) / vec2(0.0, 2.0); })",
     {"go"}},
    {"an output stays what its step saw",
     R"(
      input a : float[W, H];
      state p : float[W] = 1.0; state q : float[W] = 5.0;
      step look { output seen = p, sum = sum(a); }
      step swap { p <- q; q <- p; output other = q; })",
     {"look", "swap"}},
    {"a non-finite contribution spoils its own element only",
     R"(
      input a : float[W, H];
      let x = select(lessThan(vec2(a), vec2(0.3)), vec2(a), vec2(1.0) / vec2(0.0));
      step go { output sums = scatter_add(coord(W, H).x, x, W), fine = scatter_add(coord(W, H).y, a, H); })",
     {"go"}},
    {"regions, nested, with their gradients",
     R"(
      param w : vec2[V] = vec2(0.5, -0.25);
      input a : float[W, H];
      fn walk(w: vec2[V], x: float) -> float {
        reduce(sum, i in 0..6) { if x > 0.1 * float(i) { dot(w.at(i % 4), vec2(x, x * x)) * exp(-x) } else { w.at(3).x } }
      }
      fn steepest(w: vec2[V], x: float) -> float { reduce(max, i in 0..4) { w.at(i).x * float(i) + x } }
      let y = walk(w, a) + steepest(w, a);
      let total = mean(y * y);
      step go { output total, gradient = grad(total, w), y; })",
     {"go"}},
    {"many outputs, layers and shifts",
     R"(
      input a : float[W, H];
      let c = float(coord(1, 1, 3).z) + 1.0;
      let b = a * c;
      let s = shift(b, 1, -1) + shift(b, -2, 0);
      step go { output o0 = b, o1 = s, o2 = b + s, o3 = vec3(b, s, a), o4 = sum(b, over = layers), o5 = max(b, over = x), o6 = min(s, over = y),
                o7 = b > s, o8 = int(b * 9.0), o9 = sum(s), o10 = mean(vec2(b, s)); })",
     {"go"}},
    {"leaves that are overwritten in place, and leaves that must not be",
     R"(
      input a : float[W, H];
      state p : float[W] = 1.0; state q : float[W] = 2.0; state r : float[W] = 3.0; state s : vec3[W, H] = vec3(1.0, 2.0, 3.0);
      let total = sum(a);
      step go {
        p <- p * 0.5 + total;
        q <- q.at(coord(W, 1).x + 1) + p;
        r <- r + q * total;
        s <- s * 0.5 + shift(s, 1, 0) * a;
        output sum_r = sum(r), old_q = q; }
      step look { output p1 = p, q1 = q, r1 = r, s1 = s; })",
     {"go", "go", "go", "look"}},
    {"counters",
     R"(
      input a : float[W, H];
      state n : int = 0;
      step go { n <- n + step_index; output n, index = step_index, sum = sum(a); })",
     {"go", "go", "go", "go"}},
};

constexpr int kWidth = 7, kHeight = 5;

Array input() {
  std::vector<float> values;
  for (int k = 0; k < kWidth * kHeight; ++k) values.push_back(0.5f + 0.5f * std::sin(static_cast<float>(k * k)));
  return Array::from_floats(values, 1, kWidth, kHeight, 1);
}

template <class T>
T must(io::Result<T> result) {
  if (!result) FAIL(result.error());
  if constexpr (!std::is_void_v<T>) return std::move(result).value();
}

template <class P>
void run(P& program, const Case& c, bool has_v) {
  must(program.bind("a", input()));
  if (has_v) must(program.bind_symbol("V", 4));
  for (const char* step : c.steps) must(program.run(step));
}

}  // namespace

TEST_CASE("small programs give the evaluator's answer on every device and lowering") {
  const auto all = test::devices();
  const std::string path = (std::filesystem::path(DR_BUILD_DIR) / "small_program.dr").string();
  for (const Case& c : kCases) {
    std::ofstream(path) << "edition 1;\n" << c.text;
    const bool has_v = std::string(c.text).find("[V]") != std::string::npos;
    const auto compile = [&](const jit::Options& options) {
      auto bundle = jit::compile_file(path, options);
      if (auto* messages = std::get_if<std::string>(&bundle)) FAIL(c.name << ": " << *messages);
      return std::get<std::vector<uint8_t>>(bundle);
    };
    jit::Options options;
    options.profile = "lavapipe";
    auto reference = must(jit::ReferenceProgram::load(compile(options)));
    run(reference, c, has_v);
    for (const auto& [name, device] : all)
      for (const char* lower : {"fragment", "compute"})
        for (const char* pack : {"fused", "naive", "subpasses"}) {
          INFO(c.name << ": " << name << " " << lower << " " << pack);
          options.profile = name;
          options.lower = lower;
          options.raster = std::string(lower) == "fragment" ? "hardware" : "compute";
          const bool subpasses = std::string(pack) == "subpasses";
          options.pack = subpasses ? "fused" : pack;
          options.ablate = subpasses ? std::vector<std::string>{"substages", "remat"} : std::vector<std::string>{};
          auto program = must(runtime::Program::load(device, compile(options)));
          run(program, c, has_v);
          for (const std::string& step : program.steps())
            for (const std::string& output : program.outputs(step)) {
              INFO(step << "." << output);
              const auto found = must(program.output(step, output)).to_doubles(),
                         expected = must(reference.output(step, output)).to_doubles();
              REQUIRE(found.size() == expected.size());
              for (size_t k = 0; k < found.size(); ++k) {
                const bool same_special = (std::isnan(found[k]) && std::isnan(expected[k])) || found[k] == expected[k];
                if (!same_special)
                  CHECK(std::fabs(found[k] - expected[k]) <= 1e-5 * std::max(1.0, std::fabs(expected[k])));
              }
            }
          for (const std::string& message : device.validation_messages()) FAIL("validation: " << message);
        }
  }
}
