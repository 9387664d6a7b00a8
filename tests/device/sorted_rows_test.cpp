// SPDX-License-Identifier: Apache-2.0
// Rows that the device sorts, of indices that are computed of what a step does not change: against the float64
// evaluator, bit by bit against rows that the host makes, on every run, and when the index is bound anew.
#include <cmath>
#include <filesystem>
#include <fstream>
#include <random>

#include "runtime/jit/jit.h"
#include "runtime/jit/reference_program.h"
#include "runtime/runtime.h"
#include "tests/catch.h"
#include "tests/device/compile.h"
#include "tests/device/devices.h"

using namespace dr;
using io::Array;
using test::must;

namespace {

constexpr double kTolerance = 1e-6;  // relative L2

// `gain` stays 1, which the compiler does not know. `sorted` and `pairs` have the indices of `host` and `host_pairs` as
// long as `move` is 0; `texture` reads behind a condition that stays, `tinted` behind one that the step changes.
const char* const kText = R"(edition 1;
import std.texture;
input index : ivec2[S];
input x : vec2[S];
input move : int;
param gain : float = 1.0;
let own = gain * x;
let i = index + ivec2(move, move);
let host = scatter_add(index.x, own, T);
let sorted = scatter_add(i.x, own, T);
let host_pairs = scatter_add(index.x, own, T) + scatter_add(index.y, own.yx, T);
let pairs = scatter_add(i.x, own, T) + scatter_add(i.y, own.yx, T);
let image = scatter_add(ivec2(i.x % 20, i.y / 20), int(gain), 20, 15);
let wide = gain * float(coord(S, 1, 3).z + 1) * x.x;
let layers = scatter_add(i.x, wide, T, 1, 3);

input room : float[T];  // 300: only sums of many elements, as many as data says, go by rows
param tone : vec3[U, V];
let uv = vec2(float(i.x) / 300.0, float(i.y) / 300.0);
let read = if i.x >= 0 { texture.bilinear(tone, uv) * own.x } else { vec3(0.0) };
let tinted = if own.y > 0.3 { texture.bilinear(tone, uv.yx) * own.x } else { texture.bilinear(tone, uv) };
step run {
  gain <- gain + 1.0 - 1.0;
  output host, sorted, host_pairs, pairs, image, layers,
         texture = grad(sum(read * read), tone) + 0.5 * tone, tinted = grad(sum(tinted), tone);
}
)";
const char* const kOutputs[] = {"host", "sorted", "host_pairs", "pairs", "image", "layers", "texture", "tinted"};

struct Data {
  const char* name;
  std::vector<int32_t> index;  // pairs
  std::vector<float> x;        // pairs
};

std::vector<Data> data_sets() {
  std::mt19937 random(11);
  const auto real = [&](double low, double high) { return std::uniform_real_distribution<double>(low, high)(random); };
  const auto target = [&](int low, int high) { return std::uniform_int_distribution<int>(low, high)(random); };
  std::vector<Data> sets;
  const auto make = [&](const char* name, size_t sources, auto index) {
    Data d{name, {}, {}};
    for (size_t k = 0; k < 2 * sources; ++k) {
      d.index.push_back(index(k));
      d.x.push_back(static_cast<float>((k % 3 == 0 ? -1 : 1) * std::pow(10.0, real(-3, 3))));
    }
    sets.push_back(std::move(d));
  };
  make("many of few", 5000, [&](size_t) { return target(0, 299); });
  make("all of one", 20000, [](size_t) { return 137; });
  make("out of range and empty rows", 65, [&](size_t) { return 7 * target(-20, 80); });
  make("one source", 1, [](size_t) { return 5; });
  return sets;
}

std::vector<uint8_t> compile(const std::string& profile, const std::string& scatter) {
  const auto path = (std::filesystem::path(DR_BUILD_DIR) / "sorted_rows_test.dr").string();
  std::ofstream(path) << kText;
  return test::compile(path, profile, scatter);
}

template <class P>
std::vector<Array> run(P& program) {
  must(program.run("run"));
  std::vector<Array> out;
  for (const char* name : kOutputs) out.push_back(must(program.output("run", name)));
  return out;
}

template <class P>
void bind(P& program, const Data& data, int32_t move = 0) {
  must(program.bind("index", Array::from_ints(data.index, 2)));
  must(program.bind("x", Array::from_floats(data.x, 2)));
  must(program.bind("move", Array::from_ints(std::vector<int32_t>{move})));
  must(program.bind("room", Array::from_floats(std::vector<float>(300))));
  must(program.bind("tone", Array::from_floats(std::vector<float>(13 * 11 * 3, 1.0F), 3, 13, 11)));
}

void check_close(const std::vector<Array>& found, const std::vector<Array>& truth) {
  for (size_t o = 0; o < truth.size(); ++o) {
    INFO(kOutputs[o]);
    const auto x = found[o].to_doubles(), y = truth[o].to_doubles();
    REQUIRE(x.size() == y.size());
    double difference = 0, size = 0;
    for (size_t k = 0; k < x.size(); ++k) {
      difference += (x[k] - y[k]) * (x[k] - y[k]);
      size += y[k] * y[k];
    }
    CHECK(std::sqrt(difference) <= kTolerance * std::sqrt(size));
  }
}

void check_same(const std::vector<Array>& a, const std::vector<Array>& b) {
  for (size_t o = 0; o < a.size(); ++o) {
    INFO(kOutputs[o]);
    CHECK(a[o].bytes == b[o].bytes);
  }
}

}  // namespace

TEST_CASE("rows that the device sorts are those that the host makes") {
  const auto sets = data_sets();
  std::vector<std::vector<Array>> truths;
  for (const Data& data : sets) {
    auto reference = must(jit::ReferenceProgram::load(compile("lavapipe", "auto")));
    bind(reference, data);
    truths.push_back(run(reference));
  }
  for (const auto& [name, device] : test::devices()) {
    const auto bundle = compile(name, "rows");
    CHECK(bundle == compile(name, "auto"));
    for (size_t k = 0; k < sets.size(); ++k) {
      INFO(name << ": " << sets[k].name);
      auto program = must(runtime::Program::load(device, bundle));
      bind(program, sets[k]);
      const auto first = run(program);
      check_close(first, truths[k]);
      CHECK(first[0].bytes == first[1].bytes);
      CHECK(first[2].bytes == first[3].bytes);
      check_same(run(program), first);
    }
  }
}

TEST_CASE("rows are sorted again when what the index depends on is bound anew, and only then") {
  const Data data = data_sets()[2];
  for (const auto& [name, device] : test::devices()) {
    INFO(name);
    const auto bundle = compile(name, "rows");
    auto program = must(runtime::Program::load(device, bundle));
    auto reference = must(jit::ReferenceProgram::load(bundle));
    bind(program, data);
    run(program);
    const int64_t all = program.counters("run").run.commands;
    run(program);
    const int64_t steady = program.counters("run").run.commands - all;
    CHECK(steady < all - 19);  // one table takes so many at least
    for (const int32_t move : {3, 1000, 0}) {
      INFO(move);
      must(program.bind("move", Array::from_ints(std::vector<int32_t>{move})));
      bind(reference, data, move);
      const int64_t before = program.counters("run").run.commands;
      const auto found = run(program);
      CHECK(program.counters("run").run.commands - before > steady + 19);
      check_close(found, run(reference));
    }
    auto fresh = must(runtime::Program::load(device, bundle));
    bind(fresh, data);
    check_same(run(program), run(fresh));
  }
}
