// SPDX-License-Identifier: Apache-2.0
// Loops that take more trips than a driver lets an invocation have: they are cut, and give what they would give in one
// piece. A profile that allows few trips cuts small programs, whose bits must be those of the same programs with the
// device's own; at the true limit sums are known.
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <map>

#include "compiler/target/profile.h"
#include "runtime/jit/jit.h"
#include "runtime/jit/measure.h"
#include "runtime/runtime.h"
#include "tests/catch.h"
#include "tests/device/compile.h"
#include "tests/device/devices.h"

using namespace dr;
using io::Array;
using runtime::Program;
using test::must;

namespace {

// A profile that allows so many trips, in a file of this process alone.
class Few {
 public:
  Few(const std::string& device, uint32_t trips, bool lanes_in_turn) {
    target::Profile profile = std::get<target::Profile>(target::load_profile(device));
    profile.loop_trips = trips;
    profile.lanes_in_turn = profile.lanes_in_turn && lanes_in_turn;
    path_ = std::filesystem::temp_directory_path() /
            (device + "_" + std::to_string(trips) + "_trips_" + std::to_string(getpid()) + ".json");
    std::ofstream(path_) << target::write_profile(profile);
  }
  ~Few() {
    std::error_code ignored;
    std::filesystem::remove(path_, ignored);
  }
  std::string path() const { return path_.string(); }

 private:
  std::filesystem::path path_;
};

// Every way in which a loop stands in a program: alone, beside others, in another, in a branch, with a range that
// depends on data, with its gradient, and with what its result indexes.
const char* const kProgram = R"(edition 1;
  input a : vec3[V];
  input n : int[P];
  param x : float[P] = 0.5;
  param w : float[V] = 1.0;
  let alone = reduce(sum, i in 0..V) { x * a.at(i).x };
  let pair = reduce(min, i in 0..V) { (abs(a.at(i).y - x), a.at(i)) };
  let nearest = reduce(argmin, i in 0..V) { abs(a.at(i).z - alone) };
  let behind = reduce(max, i in nearest..V) { a.at(i).x * pair.0 };
  let nested = reduce(sum, i in 0..V) {
    let row = reduce(sum, j in 0..i) { a.at(j) * float(i) };
    let some = if row.x > 0.2 { reduce(max, k in 0..V) { a.at(k).y + row.z } } else { row.y };
    some * x + w.at(i)
  };
  let counted = reduce(sum, i in 0..n) { w.at(i % V) * x };
  let bounded = reduce(sum, i in 0..n, max = 400) { float(i) * x };
  let branch = if x > 0.6 { reduce(sum, i in 0..V) { exp(-a.at(i).x * x) } } else { nested };
  let loss = sum(alone + pair.0 * 0.1 + behind + nested + counted + branch + pair.1.z);
  step look {
    output alone, nearest, behind, nested, counted, bounded, branch, loss;
    output d = scatter_add(nearest, x * nested, V);
  }
  step fit { let g = grad(loss, (x, w)); x <- x - 0.0001 * g.0; w <- w - 0.0001 * g.1; output dx = g.0, dw = g.1; }
)";

constexpr int64_t kV = 70, kP = 33;

void bind(Program& program) {
  std::vector<float> points, starts;
  std::vector<int32_t> counts;
  for (int64_t k = 0; k < 3 * kV; ++k) points.push_back(static_cast<float>((k * 37 % 101)) / 101.0F);
  for (int64_t k = 0; k < kP; ++k) counts.push_back(static_cast<int32_t>(k * 53 % 391));
  for (int64_t k = 0; k < kP; ++k) starts.push_back(static_cast<float>((k * 29 % 31)) / 31.0F);
  must(program.bind("a", Array::from_floats(points, 3, kV)));
  must(program.bind("n", Array::from_ints(counts)));
  must(program.bind("x", Array::from_floats(starts, 1, kP)));
}

using Results = std::vector<std::pair<std::string, std::vector<std::byte>>>;

Results results_of(const runtime::Device& device, const std::string& file, const jit::Options& options) {
  Program program = must(Program::load(device, test::compile(file, options)));
  bind(program);
  Results out;
  for (const std::string step : {"look", "fit"}) {
    must(program.run(step, 3));
    for (const std::string& name : program.outputs(step))
      out.emplace_back(name, must(program.output(step, name)).bytes);
  }
  out.emplace_back("w", must(program.leaf("w")).bytes);
  return out;
}

std::string written(const std::string& name, const std::string& text) {
  const auto path = std::filesystem::path(DR_BUILD_DIR) / (name + "_" + std::to_string(getpid()) + ".dr");
  std::ofstream(path) << text;
  return path.string();
}

}  // namespace

TEST_CASE("the trips that are measured are those of the profile") {
  for (const auto& [name, device] : test::devices()) {
    INFO(name);
    const auto profile = std::get<target::Profile>(target::load_profile(name));
    CHECK(must(jit::measure_loop_trips(device)) == profile.loop_trips);
  }
}

TEST_CASE("cut loops give the bits of whole ones") {
  const std::string file = written("long_loops", kProgram);
  for (const auto& [name, device] : test::devices()) {
    for (const std::string lower : {"compute", "fragment"})
      for (const std::string pack : {"fused", "naive"})
        for (const std::string scatter : {"auto", "exact"}) {
          jit::Options options;
          options.lower = lower;
          options.pack = pack;
          options.scatter = scatter;
          // With the true limit: in one piece on SwiftShader, in a few on lavapipe.
          options.profile = name;
          const Results expected = results_of(device, file, options);
          for (const bool in_turn : {true, false}) {
            if (!in_turn && name != "lavapipe") continue;
            constexpr uint32_t kTrips = 1500;
            INFO(name << ", " << lower << ", " << pack << ", scatter " << scatter << (in_turn ? "" : ", branching"));
            const Few few(name, kTrips, in_turn);
            options.profile = few.path();
            const Results found = results_of(device, file, options);
            REQUIRE(found.size() == expected.size());
            for (size_t k = 0; k < found.size(); ++k) {
              INFO(found[k].first);
              CHECK(found[k].second == expected[k].second);
            }
          }
        }
  }
  std::filesystem::remove(file);
}

TEST_CASE("loops count right at, below and above the true limit") {
  const std::string file = written("true_limit", R"(edition 1;
    input a : float[V];
    param x : float[9] = 1.0;
    step count {
      output one = reduce(sum, i in 0..V) { x }, last = reduce(max, i in 0..V) { float(i) * a.at(i) },
        where = reduce(argmin, i in 0..V) { -float(i) }, again = reduce(sum, i in 0..V) { a.at(V - 1 - i) * x },
        nested = reduce(sum, i in 0..V) { reduce(sum, j in 0..30) { if j % 10 == 0 { x } else { 0.0 } } };
    }
  )");
  for (const auto& [name, device] : test::devices())
    for (const int64_t size : {30, 2113, 2114, 65534, 65535, 65536, 200000}) {
      INFO(name << ", " << size);
      jit::Options options;
      options.profile = name;
      Program program = must(Program::load(device, test::compile(file, options)));
      must(program.bind("a", Array::from_floats(std::vector<float>(static_cast<size_t>(size), 1.0F), 1, size)));
      must(program.run("count"));
      const auto all = [&](const std::string& output, double value) {
        INFO(output);
        CHECK(must(program.output("count", output)).to_doubles() == std::vector<double>(9, value));
      };
      const auto n = static_cast<double>(size);
      CHECK(must(program.output("count", "last")).to_doubles() == std::vector<double>(1, n - 1));
      CHECK(must(program.output("count", "where")).to_doubles() == std::vector<double>(1, n - 1));
      all("one", n);
      all("again", n);
      all("nested", 3 * n);
    }
  std::filesystem::remove(file);
}

// A shader that is joined with another, drawn, or run for many items cannot stop within a loop. Where nothing but data
// bounds a loop, the run fails rather than end it early.
TEST_CASE("loops that data bounds come to their end, or the run fails") {
  const std::string file = written("loops_of_data", R"(edition 1;
    input n : int[P, Q];
    param x : float[P, Q] = 1.0;
    param w : float[8] = 1.0;
    let long = reduce(sum, i in 0..n) { x };
    let hot = if x > 0.5 { reduce(sum, i in 0..n) { x * w.at(i % 8) } } else { 0.0 };
    step value { output long; }
    step place { output d = scatter_add(int(x * 0.0), hot, 8); }
    step slope { let g = grad(sum(hot), w); output g; }
  )");
  constexpr int kTrips = 100000, kSide = 3;
  const double all = kTrips * kSide * kSide;
  const std::map<std::string, std::pair<std::string, std::vector<double>>> expected = {
      {"value", {"long", std::vector<double>(kSide * kSide, kTrips)}},
      {"place", {"d", {all, 0, 0, 0, 0, 0, 0, 0}}},
      {"slope", {"g", std::vector<double>(8, all / 8)}}};
  for (const auto& [name, device] : test::devices())
    for (const std::string lower : {"compute", "fragment"})
      for (const std::string scatter : {"auto", "exact", "atomic", "rows"}) {
        if (scatter == "atomic" && name != "lavapipe") continue;
        jit::Options options;
        options.lower = lower;
        options.scatter = scatter;
        options.profile = name;
        Program program = must(Program::load(device, test::compile(file, options)));
        must(program.bind("n", Array::from_ints(std::vector<int32_t>(kSide * kSide, kTrips), 1, kSide, kSide)));
        for (const auto& [step, of] : expected) {
          INFO(name << ", " << lower << ", " << scatter << ", " << step);
          if (!program.run(step)) {
            CHECK(name == "lavapipe");
            continue;
          }
          const auto found = program.output(step, of.first);
          if (!found) {
            CHECK(name == "lavapipe");
            continue;
          }
          CHECK(found->to_doubles() == of.second);
        }
      }
  std::filesystem::remove(file);
}

TEST_CASE("what a loop promises beside others is kept, whatever its range") {
  const std::string file = written("promised_loops", R"(edition 1;
    input n : int;
    input m : int;
    let long = reduce(sum, k in 0..n, max = 1000) { 1 };
    let beside = fold(k in 0..m, s = 0, max = 1000) { s + 1 };
    step s { output long, beside; }
  )");
  for (const auto& [name, device] : test::devices()) {
    INFO(name);
    jit::Options options;
    options.profile = name;
    Program program = must(Program::load(device, test::compile(file, options)));
    must(program.bind("n", Array::from_ints(std::vector<int32_t>{150000}, 1, 1, 1)));
    must(program.bind("m", Array::from_ints(std::vector<int32_t>{500}, 1, 1, 1)));
    must(program.run("s"));
    CHECK(must(program.output("s", "long")).to_doubles() == std::vector<double>{1000});
    CHECK(must(program.output("s", "beside")).to_doubles() == std::vector<double>{500});
  }
  std::filesystem::remove(file);
}

// The gradient's scatter may join the pass that computes its conditions.
TEST_CASE("short loops behind long ones come to their end") {
  const std::string file = written("behind_long", R"(edition 1;
    input a : float[V];
    input x : float[P];
    param w : float[8] = 1.0;
    let long = reduce(sum, i in 0..V) { a.at(i) * x };
    let hot = if long > 0.5 { reduce(sum, i in 0..100) { sqrt(w.at(i % 8) + long * 0.001) } } else { 0.0 };
    step fit { w <- w - 0.0001 * grad(sum(hot), w); output hot; }
  )");
  constexpr int64_t kLong = 4000, kElements = 100;
  std::vector<float> x;
  for (int64_t k = 0; k < kElements; ++k) x.push_back(static_cast<float>(k * 29 % 31) / 31.0F);
  for (const auto& [name, device] : test::devices())
    for (const std::string scatter : {"exact", "atomic"}) {
      if (scatter == "atomic" && name != "lavapipe") continue;
      std::vector<std::vector<double>> found;
      for (const uint32_t trips : {0, 1500}) {
        const Few few(name, trips, false);
        jit::Options options;
        options.scatter = scatter;
        const std::string profile = few.path();
        options.profile = trips == 0 ? name : profile;
        Program program = must(Program::load(device, test::compile(file, options)));
        must(program.bind("a", Array::from_floats(std::vector<float>(kLong, 0.01F), 1, kLong)));
        must(program.bind("x", Array::from_floats(x, 1, kElements)));
        must(program.run("fit"));
        found.push_back(must(program.leaf("w")).to_doubles());
      }
      INFO(name << ", " << scatter);
      for (size_t k = 0; k < found[0].size(); ++k)
        CHECK(std::abs(found[0][k] - found[1][k]) <= (scatter == "exact" ? 0 : 1e-6));
    }
  std::filesystem::remove(file);
}

// Most items of a row lie in blocks that another row begins or ends in, so that its walk takes them one by one, twice.
TEST_CASE("the loops of a row's items come to their end") {
  constexpr int64_t kItems = 511;
  std::vector<int32_t> targets(kItems, 1);
  targets[0] = 0;
  for (const auto& [name, device] : test::devices())
    for (const std::string extent : {"N", "511"})
      for (const std::string trips : {"100", "5"}) {
        const std::string file =
            written("row_items", "edition 1; input i : int[" + extent + "]; param x : float[" + extent + R"(] = 0.5;
          param a : float[4] = 1.0;
          let t = if x > 0.1 { a.at(i) * reduce(sum, k in 0..)" +
                                     trips +
                                     R"() { x * float(k) + 0.25 } } else { 0.0 };
          step look { output sums = grad(sum(t), a); }
        )");
        Program program = must(Program::load(device, test::compile(file, name, "rows")));
        std::filesystem::remove(file);
        must(program.bind("i", Array::from_ints(targets, 1, kItems)));
        must(program.run("look"));
        const auto sums = must(program.output("look", "sums")).to_doubles();
        const double n = std::stod(trips), one = 0.25 * n * (n - 1) + 0.25 * n;
        INFO(name << ", " << extent << ", " << trips);
        CHECK(sums[0] == one);
        CHECK(sums[1] == (kItems - 1) * one);
      }
}

// Each alone may be drawn; together they take more trips than an invocation may.
TEST_CASE("loops that share a drawn shader come to their end") {
  std::string text = "edition 1; param a : float[W, H] = 0.5; input b : int[M]; let y = 0.0";
  for (int k = 0; k < 20; ++k)
    text += " + a.at(ivec2((coord(W, H).x + reduce(sum, j in 0..4000) { b.at((j + " + std::to_string(k) +
            ") % M) * (coord(W, H).x + 1) }) % W, 0))";
  const std::string file = written("together", text + "; step go { output y; }");
  for (const auto& [name, device] : test::devices()) {
    jit::Options options;
    options.profile = name;
    options.lower = "fragment";
    Program program = must(Program::load(device, test::compile(file, options)));
    std::vector<float> a(12);
    for (size_t k = 0; k < a.size(); ++k) a[k] = static_cast<float>(k % 4 + 1);
    must(program.bind("a", Array::from_floats(a, 1, 4, 3)));
    std::vector<int32_t> b(7, 1);
    must(program.bind("b", Array::from_ints(b, 1, 7)));
    must(program.run("go"));
    // 4,000 (x + 1) steps to the right: back to x.
    const auto y = must(program.output("go", "y")).to_doubles();
    INFO(name);
    for (size_t k = 0; k < y.size(); ++k) CHECK(y[k] == 20 * static_cast<double>(k % 4 + 1));
  }
  std::filesystem::remove(file);
}
