// SPDX-License-Identifier: Apache-2.0
// The C++ API misused: each call answers in words, and the program is usable afterwards.
#include <atomic>
#include <climits>
#include <cmath>
#include <filesystem>
#include <thread>

#include "runtime/jit/jit.h"
#include "runtime/jit/measure.h"
#include "runtime/jit/reference_program.h"
#include "runtime/runtime.h"
#include "tests/catch.h"
#include "tests/device/compile.h"
#include "tests/device/devices.h"

// What was moved from is what some cases are about.
// NOLINTBEGIN(bugprone-use-after-move,clang-analyzer-cplusplus.Move)
using namespace dr;
using io::Array;

namespace {

constexpr const char* kFit = R"(edition 1;
param p : float[W] = 0.0;
input t : float[W];
let d = p - t;
step fit { p <- p - 0.5 * grad(mean(d * d), p); output error = mean(d * d), q = p; }
)";

std::vector<uint8_t> fit_bundle(const std::string& profile) {
  return test::compile_text("api_faults.dr", kFit, profile);
}

// The call fails, and says this.
template <class T>
void refuses(const io::Result<T>& result, const std::string& says) {
  REQUIRE_FALSE(static_cast<bool>(result));
  INFO("expected: " << says << "\n  found: " << result.error());
  CHECK(result.error().find(says) != std::string::npos);
}

Array ones(int64_t width) { return Array::from_floats(std::vector<float>(static_cast<size_t>(width), 1.0f), 1); }

// It fits eight ones.
void works(runtime::Program& program) {
  REQUIRE(program.bind("t", ones(8)));
  REQUIRE(program.run("fit", 2));
  const auto error = program.output("fit", "error");
  REQUIRE(error);
  CHECK(std::isfinite(error->to_doubles()[0]));
}

// Runs `what` with each device, and its bundle.
template <class F>
void everywhere(F&& what) {
  for (auto& [name, device] : test::devices()) {
    INFO(name);
    what(device, fit_bundle(name));
  }
}

}  // namespace

TEST_CASE("arrays that do not agree with themselves are refused, and symbols stay free") {
  everywhere([](runtime::Device& device, const std::vector<uint8_t>& bundle) {
    auto program = test::must(runtime::Program::load(device, bundle));
    Array bad = ones(8);
    bad.bytes.resize(4);
    refuses(program.bind("t", bad), "do not agree");
    bad.bytes.resize(64 << 20);
    refuses(program.bind("t", bad), "do not agree");
    refuses(program.bind("t", Array{}), "it is empty");
    bad = ones(8);
    bad.components = 1'000'000;
    refuses(program.bind("t", bad), "do not agree");
    bad = ones(8);
    bad.width = int64_t{1} << 62;
    refuses(program.bind("t", bad), "do not agree");
    bad.width = -8;
    refuses(program.bind("t", bad), "do not agree");
    refuses(program.bind("t", Array::from_floats(std::vector<float>(8, 1.0f), 2)), "1 components an element");
    refuses(program.bind("t", Array::from_doubles(std::vector<double>(5, 1e300))), "cannot turn float64 into float32");
    for (const int64_t size : {int64_t{-5}, int64_t{0}, int64_t{1} << 40})
      refuses(program.bind_symbol("W", size), "which is not between 1 and 2^31");
    refuses(program.bind_symbol("Q", 4), "there is no symbol 'Q'");
    works(program);
    refuses(program.bind("t", ones(5)), "'W' is 8 since leaf 't' was first bound, but 5 now");
    works(program);
    // What came in while the program had memory already.
    bad = ones(8);
    bad.bytes.resize(64 << 20);
    refuses(program.bind("t", bad), "do not agree");
    works(program);
  });
}

TEST_CASE("an array in memory that is none is refused") {
  CHECK(runtime::HostArray{}.copied().empty());
  float number = 1;
  for (const int64_t size : {int64_t{-3}, int64_t{0}, int64_t{1} << 40, int64_t{1} << 62})
    CHECK(runtime::HostArray{.width = size, .height = 4, .data = &number}.copied().empty());
  CHECK(runtime::HostArray{.data = &number}.copied().consistent());
  everywhere([&](runtime::Device& device, const std::vector<uint8_t>& bundle) {
    auto program = test::must(runtime::Program::load(device, bundle));
    for (int k = 0; k < 2; ++k) {  // the leaf has memory the second time
      refuses(program.bind("t", runtime::HostArray{.width = 8}), "leaf 't': the array has no data");
      refuses(program.bind("t", runtime::HostArray{}), "leaf 't': the array has no data");
      refuses(program.bind("t", runtime::HostArray{.width = -8, .data = &number}), "-8 x 1 x 1 elements");
      refuses(program.bind("t", runtime::HostArray{.width = int64_t{1} << 62, .height = 4, .data = &number}),
              " x 4 x 1 elements");
      works(program);
    }
  });
}

TEST_CASE("what there is not is named") {
  everywhere([](runtime::Device& device, const std::vector<uint8_t>& bundle) {
    auto program = test::must(runtime::Program::load(device, bundle));
    refuses(program.run("nowhere"), "there is no step 'nowhere'");
    refuses(program.bind("zz", ones(8)), "there is no leaf 'zz'");
    refuses(program.output("fit", "zz"), "has no output 'zz'");
    refuses(program.run("fit"), "needs data for leaf 't'");
    refuses(program.output("fit", "q"), "has not run yet");
    refuses(program.timed_run("zz"), "there is no step");
    refuses(program.checked_run("fit"), "needs data");
    refuses(program.rasters("zz"), "there is no step");
    refuses(program.pins("fit"), "has not run yet");
    refuses(program.resource("zz"), "there is no resource");
    CHECK(program.needed_leaves("zz").empty());
    CHECK_FALSE(program.is_input("zz"));
    CHECK(program.counters("zz").runs == 0);
    works(program);
  });
}

TEST_CASE("an output that is an input stays what the last run read") {
  const char* const text = R"(edition 1;
    input x : float[W];
    step go { output same = x, twice = 2.0 * x; }
  )";
  everywhere([&](runtime::Device& device, const std::vector<uint8_t>&) {
    auto program =
        test::must(runtime::Program::load(device, test::compile_text("input_output.dr", text, device.profile_name())));
    REQUIRE(program.bind("x", ones(4)));
    REQUIRE(program.run("go", 1));
    REQUIRE(program.bind("x", Array::from_floats(std::vector<float>(4, 3.0f), 1)));
    for (const auto& [name, value] : {std::pair{"same", 1.0}, std::pair{"twice", 2.0}})
      CHECK(test::must(program.output("go", name)).to_doubles() == std::vector<double>(4, value));
    if (const auto view = test::must(program.leaf_view("x"))) static_cast<float*>(view->data)[0] = 5;
    CHECK(test::must(program.output("go", "same")).to_doubles()[0] == 1);
    REQUIRE(program.run("go", 1));
    CHECK(test::must(program.output("go", "same")).to_doubles()[3] == 3);
  });
}

TEST_CASE("a mesh that is bound anew has as many edges") {
  const char* const text = R"(edition 1;
    input face : ivec3[F];
    let table = topology(face, 6);
    step go { output edges = table.edge.width; }
  )";
  const auto faces = [](std::vector<int32_t> numbers) { return Array::from_ints(numbers, 3); };
  everywhere([&](runtime::Device& device, const std::vector<uint8_t>&) {
    auto program =
        test::must(runtime::Program::load(device, test::compile_text("edges.dr", text, device.profile_name())));
    REQUIRE(program.bind("face", faces({0, 1, 2, 2, 1, 3})));
    REQUIRE(program.run("go", 1));
    refuses(program.bind("face", faces({0, 1, 2, 3, 4, 5})), "leaf 'face' has a topology of 6 for 'edge'");
    REQUIRE(program.bind("face", faces({0, 1, 3, 3, 1, 2})));
    REQUIRE(program.run("go", 1));
    CHECK(test::must(program.output("go", "edges")).to_doubles()[0] == 5);
  });
}

TEST_CASE("a step runs once or more often") {
  everywhere([](runtime::Device& device, const std::vector<uint8_t>& bundle) {
    auto program = test::must(runtime::Program::load(device, bundle));
    REQUIRE(program.bind("t", ones(8)));
    for (const int times : {0, -5}) refuses(program.run("fit", times), "once or more often, found");
    refuses(program.output("fit", "q"), "has not run yet");
    refuses(program.set_runs("fit", -1), "cannot have run -1 times");
    // Memory is there, but no run was.
    REQUIRE(program.command_count("fit"));
    refuses(program.output("fit", "q"), "has not run yet");
    works(program);
    REQUIRE(program.set_runs("fit", INT32_MAX - 2));
    refuses(program.run("fit", 3), "its counter ends at 2^31 - 1");
    REQUIRE(program.run("fit", 2));
    refuses(program.checked_run("fit"), "its counter ends at 2^31 - 1");
    refuses(program.timed_run("fit"), "its counter ends at 2^31 - 1");
  });
}

TEST_CASE("objects that were moved from are empty, and say so") {
  everywhere([](runtime::Device& device, const std::vector<uint8_t>& bundle) {
    const std::string empty = "is empty: it was moved from";
    auto from = test::must(runtime::Program::load(device, bundle));
    auto program = std::move(from);
    refuses(from.run("fit"), empty);
    refuses(from.bind("t", ones(8)), empty);
    refuses(from.bind_symbol("W", 8), empty);
    refuses(from.set_runs("fit", 1), empty);
    refuses(from.output("fit", "q"), empty);
    refuses(from.leaf("p"), empty);
    refuses(from.resource("p"), empty);
    refuses(from.rasters("fit"), empty);
    refuses(from.pins("fit"), empty);
    refuses(from.timed_run("fit"), empty);
    refuses(from.checked_run("fit"), empty);
    refuses(from.command_count("fit"), empty);
    CHECK(from.steps().empty());
    CHECK(from.leaves().empty());
    CHECK(from.outputs("fit").empty());
    CHECK(from.resources().empty());
    CHECK(from.needed_leaves("fit").empty());
    CHECK_FALSE(from.is_input("t"));
    CHECK(from.rebuilds() == 0);
    CHECK(from.pipelines().made == 0);
    CHECK(from.counters("fit").runs == 0);
    CHECK(from.memory_use().device == 0);
    works(program);
    from = std::move(program);
    works(from);

    runtime::Device kept = std::move(device);
    refuses(runtime::Program::load(device, bundle), empty);
    refuses(jit::measure_profile(device), "cannot measure the device: the device is empty");
    refuses(jit::measure_loop_trips(device), "cannot measure the device: the device is empty");
    CHECK(device.info().name.empty());
    CHECK(device.profile_name().empty());
    CHECK(device.limits().subgroup_size == 0);
    CHECK(device.validation_messages().empty());
    CHECK_FALSE(device.validating());
    // A program holds what it needs of its device.
    auto last = test::must(runtime::Program::load(kept, bundle));
    { const runtime::Device gone = std::move(kept); }
    works(last);
  });
}

TEST_CASE("programs of one device run on several threads, each on its own") {
  everywhere([](runtime::Device& device, const std::vector<uint8_t>& bundle) {
    std::atomic<int> failed = 0;
    const auto go = [&] {
      for (int k = 0; k < 3; ++k) {
        auto program = runtime::Program::load(device, bundle);
        if (!program || !program->bind("t", ones(8)) || !program->run("fit", 5) || !program->output("fit", "q"))
          ++failed;
      }
    };
    std::thread one(go), two(go), three(go);
    one.join();
    two.join();
    three.join();
    CHECK(failed == 0);
  });
}

TEST_CASE("a rebuild that throws, or gives what is no bundle, changes nothing") {
  everywhere([](runtime::Device& device, const std::vector<uint8_t>& bundle) {
    for (const bool throws : {true, false}) {
      runtime::LoadOptions options;
      options.rebuild = [throws](const runtime::Moving&) -> io::Result<std::vector<uint8_t>> {
        if (throws) throw 5;
        return std::vector<uint8_t>(100, 7);
      };
      options.rebuild_after = 1;
      options.rebuild_beside = false;
      auto program = test::must(runtime::Program::load(device, bundle, options));
      for (int k = 0; k < 12; ++k) works(program);
    }
  });
}

TEST_CASE("a rebuild that gives another program is not taken over") {
  const char* const text = R"(edition 1;
    input moving : float;
    input still : float[W];
    step go { output y = sin(still) * cos(still) + moving, z = moving; }
  )";
  const char* const others[] = {
      "edition 1;\ninput moving : float;\nstep go { output y = moving, z = moving; }\n",
      "edition 1;\ninput moving : float;\ninput still : float[W];\nstep go { output z = still + moving; }\n",
      "edition 1;\ninput moving : float;\ninput still : float[W];\nstep go { output y = moving + still, z = moving; "
      "}\n"};
  everywhere([&](runtime::Device& device, const std::vector<uint8_t>&) {
    const auto bundle = test::compile_text("moving.dr", text, device.profile_name());
    for (size_t k = 0; k < std::size(others); ++k) {
      INFO(others[k]);
      const auto other = test::compile_text("moving_other.dr", others[k], device.profile_name());
      int calls = 0;
      runtime::LoadOptions options;
      options.rebuild = [&](const runtime::Moving&) -> io::Result<std::vector<uint8_t>> { return ++calls, other; };
      options.rebuild_after = 2;
      options.rebuild_beside = false;
      auto program = test::must(runtime::Program::load(device, bundle, options));
      REQUIRE(program.bind("still", ones(4)));
      for (int run = 0; run < 6; ++run) {
        REQUIRE(program.bind("moving", Array::from_floats(std::vector<float>{static_cast<float>(run)}, 1)));
        REQUIRE(program.run("go"));
      }
      CHECK(calls > 0);
      CHECK(program.rebuilds() == (k == 2 ? 1 : 0));  // the last has all names: it is taken at its word
      CHECK(test::must(program.output("go", "y")).width == 4);
      REQUIRE(program.leaf("still"));
    }
  });
}

TEST_CASE("pipelines were kept only by a program before") {
  const char* const text = R"(edition 1;
    input x : float[W];
    step one { output y = sin(x); }
    step two { output z = sqrt(x), total = sum(x); }
  )";
  const auto folder = std::filesystem::path(DR_BUILD_DIR) / "api_faults_pipelines";
  everywhere([&](runtime::Device& device, const std::vector<uint8_t>&) {
    const auto bundle = test::compile_text("kept.dr", text, device.profile_name());
    std::filesystem::remove_all(folder);
    for (const bool is_first : {true, false}) {
      auto program = test::must(runtime::Program::load(device, bundle, {.pipeline_folder = folder.string()}));
      REQUIRE(program.bind("x", ones(4)));
      for (const char* step : {"one", "two"}) REQUIRE(program.run(step));
      CHECK(program.pipelines().made > 1);
      if (is_first)
        CHECK(program.pipelines().kept == 0);
      else if (device.profile_name() == "lavapipe")  // SwiftShader never gives the same data twice
        CHECK(program.pipelines().kept == program.pipelines().made);
    }
  });
}

TEST_CASE("odd options and odd bundles are answered") {
  everywhere([](runtime::Device& device, const std::vector<uint8_t>& bundle) {
    refuses(runtime::Program::load(device, {}), "not a bundle");
    refuses(runtime::Program::load(device, std::vector<uint8_t>(3)), "not a bundle");
    refuses(runtime::Program::load(device, std::vector<uint8_t>(100)), "not a bundle");
    runtime::LoadOptions options;
    options.pipeline_folder = "/proc/nowhere";
    options.memory_limit = -7;
    auto program = test::must(runtime::Program::load(device, bundle, options));
    works(program);
    auto tables = test::must(runtime::Program::describe(bundle));
    REQUIRE(tables.bind("t", ones(8)));
    refuses(tables.run("fit"), "without a device");
    refuses(tables.leaf("p"), "without a device");
    refuses(tables.command_count("fit"), "without a device");
    CHECK(tables.counters("fit").runs == 0);
  });
}

TEST_CASE("a device that ends loops refuses a bundle that lets them run on") {
  const char* text = R"(edition 1;
input a : float[N];
step go { output total = reduce(sum, i in 0..N) { a.at(i) }; }
)";
  const auto bundle = test::compile_text("api_faults_loops.dr", text, "swiftshader");
  everywhere([&](runtime::Device& device, const std::vector<uint8_t>&) {
    const auto program = runtime::Program::load(device, bundle);
    if (device.profile_name() == "lavapipe")
      refuses(program, "built for profile 'swiftshader', whose devices let loops run on");
    else if (device.profile_name() == "swiftshader")
      REQUIRE(program);
  });
}

TEST_CASE("what a run left whose loops ended early is refused") {
  const char* const text = R"(edition 1;
    input n : int;
    param x : float = 0.0;
    let long = reduce(sum, i in 0..n) { float(i % 2) };
    step go { x <- x + long; output y = long; }
    step look { output z = x + 1.0; }
    step reset { x <- 7.0; }
  )";
  everywhere([&](runtime::Device& device, const std::vector<uint8_t>&) {
    if (device.profile_name() != "lavapipe") return;
    const auto trips = [](int32_t n) { return Array::from_ints(std::span(&n, 1)); };
    auto program =
        test::must(runtime::Program::load(device, test::compile_text("early.dr", text, device.profile_name())));
    const auto spoil = [&] {
      REQUIRE(program.bind("n", trips(200000)));
      for (int k = 0; k < 2; ++k) {  // what is cached is not taken for whole
        REQUIRE(program.bind("x", ones(1)));
        refuses(program.run("go"), "takes more trips");
      }
      refuses(program.output("go", "y"), "it left no results");
      refuses(program.output_view("go", "y"), "it left no results");
      for (const char* step : {"go", "look"}) refuses(program.run(step), "leaf 'x' was changed by a run whose loops");
      refuses(program.leaf("x"), "bind it again");
      refuses(program.leaf_view("x"), "bind it again");
    };
    const auto is_whole = [&](double x) {
      REQUIRE(program.bind("n", trips(10)));
      REQUIRE(program.run("go"));
      CHECK(test::must(program.output("go", "y")).to_doubles()[0] == 5);
      CHECK(test::must(program.leaf("x")).to_doubles()[0] == x + 5);
    };
    spoil();
    REQUIRE(program.bind("x", ones(1)));
    is_whole(1);
    spoil();
    REQUIRE(program.run("reset"));
    is_whole(7);
    REQUIRE(program.bind("n", trips(200000)));
    refuses(program.checked_run("go"), "takes more trips");
    REQUIRE(program.bind("x", ones(1)));
    refuses(program.timed_run("go"), "takes more trips");
  });
}

TEST_CASE("the reference answers alike") {
  auto program = test::must(jit::ReferenceProgram::load(fit_bundle("lavapipe")));
  Array bad = ones(8);
  bad.bytes.resize(4);
  refuses(program.bind("t", bad), "do not agree");
  bad.bytes.resize(64 << 20);
  refuses(program.bind("t", bad), "do not agree");
  refuses(program.bind("t", Array{}), "it is empty");
  refuses(program.bind_symbol("W", -5), "not between 1 and 2^31");
  refuses(program.run("fit", 0), "once or more often, found 0");
  refuses(program.output("fit", "q"), "has not run yet");
  REQUIRE(program.bind("t", ones(8)));
  REQUIRE(program.run("fit", 2));
  auto other = std::move(program);
  refuses(program.run("fit"), "was moved from");
  refuses(program.output("fit", "q"), "was moved from");
  CHECK(program.rasters("fit").empty());
  REQUIRE(other.run("fit"));
}

TEST_CASE("leaves and steps of the runtime's own are not the user's") {
  const char* const text = R"(edition 1;
    input face : ivec3[F];
    input base : float;
    param p : float[N] = base * float(coord(N).x + 1);
    let table = topology(face, 6);
    step go { output edges = table.edge, q = p; }
    step count { output n = table.edge.width; }
  )";
  everywhere([&](runtime::Device& device, const std::vector<uint8_t>&) {
    const auto bundle = test::compile_text("own.dr", text, device.profile_name());
    auto program = test::must(runtime::Program::load(device, bundle));
    std::vector<std::string> leaves;
    for (const auto& leaf : program.leaves()) leaves.push_back(leaf.name);
    CHECK(leaves == std::vector<std::string>{"face", "base", "p"});
    auto needed = program.needed_leaves("go");
    std::ranges::sort(needed);
    CHECK(needed == std::vector<std::string>{"base", "face", "p"});
    CHECK(program.needed_leaves("count") == std::vector<std::string>{"face"});
    refuses(program.run("count"), "step 'count' needs data for leaf 'face'");
    CHECK(program.steps() == std::vector<std::string>{"go", "count"});
    refuses(program.run("p.initial"), "there is no step 'p.initial'; there are: go, count");
    refuses(program.set_runs("p.initial", 3), "there is no step 'p.initial'");
    refuses(program.bind("q", ones(1)), "there is no leaf 'q'; there are: face, base, p");
    auto judge = test::must(jit::ReferenceProgram::load(bundle));
    refuses(judge.run("p.initial"), "there is no step 'p.initial'; there are: go");
    refuses(judge.bind("q", ones(1)), "there is no leaf 'q'; there are: face, base, p");
  });
}

TEST_CASE("a run that lacks data computes no initial value") {
  const char* const text = R"(edition 1;
    input base : float;
    input more : float[N];
    param p : float[N] = base * float(coord(N).x + 1);
    state wide : float[K, M];
    step go { output q = p + more; }
    step grow { wide <- wide + p.at(0); }
  )";
  const auto number = [](float value) { return Array::from_floats(std::span(&value, 1)); };
  const auto check = [&](auto program, const std::string& names) {
    REQUIRE(program.bind_symbol("N", 3));
    refuses(program.run("go"), names);
    REQUIRE(program.bind("base", number(1)));
    refuses(program.run("go"), "more");
    REQUIRE(program.bind_symbol("K", 1 << 30));
    REQUIRE(program.bind_symbol("M", 1 << 30));
    refuses(program.run("grow"), "has more than 2^31 elements");
    REQUIRE(program.bind("base", number(2)));
    REQUIRE(program.bind("more", ones(3)));
    REQUIRE(program.run("go"));
    CHECK(test::must(program.output("go", "q")).to_doubles() == std::vector<double>{3, 5, 7});
  };
  everywhere([&](runtime::Device& device, const std::vector<uint8_t>&) {
    const auto bundle = test::compile_text("lacks_data.dr", text, device.profile_name());
    check(test::must(runtime::Program::load(device, bundle)),
          "step 'go' needs data for leaves 'base' [1, 1, 1], 'more' [N, 1, 1]");
    auto other = test::must(runtime::Program::load(device, bundle));
    REQUIRE(other.bind_symbol("N", 3));
    refuses(other.leaf("p"), "the initial value of leaf 'p' needs data for leaf 'base'");
  });
  check(test::must(jit::ReferenceProgram::load(test::compile_text("lacks_data.dr", text, "lavapipe"))),
        "input 'base' : float, input 'more' : float[N] have no data");
}

TEST_CASE("on the reference a step's counter ends, and sizes do") {
  const char* const text = R"(edition 1;
    state wide : float[K, M];
    step grow { wide <- wide + 1.0; }
    step count { output n = step_index; }
  )";
  auto program = test::must(jit::ReferenceProgram::load(test::compile_text("counter.dr", text, "lavapipe")));
  REQUIRE(program.set_runs("count", INT32_MAX - 2));
  refuses(program.run("count", 3), "its counter ends at 2^31 - 1");
  REQUIRE(program.run("count", 2));
  refuses(program.run("count"), "its counter ends at 2^31 - 1");
  for (const char* symbol : {"K", "M"}) REQUIRE(program.bind_symbol(symbol, INT32_MAX));
  refuses(program.run("grow"), "state 'wide' has more than 2^31 elements");
}

TEST_CASE("on the reference frozen decisions are checked, and are those of the last run") {
  const char* const text = R"(edition 1;
    input position : vec2[V];
    input face : ivec3[F];
    let seen = raster(F, 8, 8, 1) {
      setup(f) -> array<vec2,3> { let i = face.at(f); [position.at(i.x), position.at(i.y), position.at(i.z)] }
      corner(s, c) -> vec2 { s[c] }
      depth(s, p) -> float { 0.5 }
    }[0];
    step look { output f = seen.face; }
  )";
  auto program = test::must(jit::ReferenceProgram::load(test::compile_text("frozen.dr", text, "lavapipe")));
  const auto corners = [](float size) { return Array::from_floats(std::vector<float>{0, 0, size, 0, 0, size}, 2); };
  REQUIRE(program.bind("face", Array::from_ints(std::vector<int32_t>{0, 1, 2}, 3)));
  REQUIRE(program.bind("position", corners(8)));
  REQUIRE(program.run("look"));
  const auto large = program.rasters("look");
  REQUIRE(program.bind("position", corners(1)));
  REQUIRE(program.run("look"));
  const auto faces = [&] { return program.rasters("look").at(0).at(0).bytes; };
  REQUIRE(faces() != large[0][0].bytes);
  REQUIRE(program.freeze("look", large));
  REQUIRE(program.run("look"));
  CHECK(faces() == large[0][0].bytes);

  refuses(program.freeze("nowhere", large), "there is no step 'nowhere'");
  auto bad = large;
  bad[0][0].bytes.resize(4);
  refuses(program.freeze("look", bad), "raster 0: faces and tags are arrays of one int32 an element");
  refuses(program.freeze("look", {{large[0][0], Array::zeros(io::ElementKind::Int32, 2, 8, 8)}}), "one int32");
  refuses(program.freeze("look", {{large[0][0], ones(64)}}), "one int32");
  bad = large;
  bad[0][0].as<int32_t>()[5] = -2;
  refuses(program.freeze("look", bad), "at least 0, or -1 for none, found -2");
  REQUIRE(program.run("look"));  // with those before
  CHECK(faces() == large[0][0].bytes);
  REQUIRE(program.freeze("look", {{large[0][0]}}));
  refuses(program.run("look"), "do not have the results of raster 0");
  REQUIRE(program.freeze("look", {}));
  REQUIRE(program.run("look"));
  CHECK(faces() != large[0][0].bytes);
}

TEST_CASE("on the reference a leaf that is read leaves others alone") {
  const char* const text = R"(edition 1;
    input seed : int = 1;
    input face : ivec3[F];
    state n : int;
    param p : float[4] = float(seed) + float(coord(4).x);
    step go { output q = p; }
    step look { output f = face; }
  )";
  auto program = test::must(jit::ReferenceProgram::load(test::compile_text("read.dr", text, "lavapipe")));
  REQUIRE(program.leaf("n"));
  REQUIRE(program.bind("seed", Array::from_ints(std::vector<int32_t>{5}, 1)));
  REQUIRE(program.run("go", 1));
  CHECK(test::must(program.output("go", "q")).to_doubles()[0] == 5);
  refuses(program.leaf("face"), "input 'face' : ivec3[F] has no data");
}

TEST_CASE("a checked run looks at what the cache would leave out, too") {
  const char* const text = R"(edition 1;
    input x : float[W];
    step go { output y = sin(x) * 2.0, total = sum(1.0 / x); }
  )";
  everywhere([&](runtime::Device& device, const std::vector<uint8_t>&) {
    auto program =
        test::must(runtime::Program::load(device, test::compile_text("cached_nan.dr", text, device.profile_name())));
    REQUIRE(program.bind("x", Array::from_floats(std::vector<float>{1, 0, 2}, 1)));
    REQUIRE(program.run("go", 2));
    for (int k = 0; k < 2; ++k) CHECK(test::must(program.checked_run("go")).has_value());
    REQUIRE(program.bind("x", ones(3)));
    CHECK_FALSE(test::must(program.checked_run("go")).has_value());
  });
}

TEST_CASE("what is read and is not finite is told of once, and so is what a pass left") {
  const char* text = R"(edition 1;
param p : float[W] = 1.0;
input t : float[W];
step look { output wide = 1.0 / t, fine = t + 1.0; }
step spoil { p <- p / t; output total = sum(p); }
)";
  const Array some = Array::from_floats(std::vector<float>{1, 0, 2, 4}, 1);
  const auto tells = [&](auto& program, std::vector<std::string>& said) {
    REQUIRE(program.bind("t", some));
    REQUIRE(program.run("look"));
    for (int k = 0; k < 2; ++k) REQUIRE(program.output("look", "fine"));
    CHECK(said.empty());
    for (int k = 0; k < 2; ++k) REQUIRE(program.output("look", "wide"));
    CHECK(said == std::vector<std::string>{"output 'look.wide' has Inf at element (1, 0, 0)"});
    said.clear();
    REQUIRE(program.run("spoil"));
  };
  everywhere([&](runtime::Device& device, const std::vector<uint8_t>&) {
    const auto bundle = test::compile_text("api_faults_nan.dr", text, device.profile_name());
    std::vector<std::string> said;
    runtime::LoadOptions options;
    options.warn = [&](const std::string& warning) { said.push_back(warning); };
    auto program = test::must(runtime::Program::load(device, bundle, options));
    tells(program, said);
    REQUIRE(said.size() == 1);
    INFO(said[0]);
    CHECK(said[0].find("left a NaN or Inf by run 1 of step 'spoil'") != std::string::npos);
    REQUIRE(program.leaf("p"));
    REQUIRE(said.size() == 2);
    CHECK(said[1] == "leaf 'p' has Inf at element (1, 0, 0)");

    options.warn = [](const std::string&) { throw 5; };
    auto thrown = test::must(runtime::Program::load(device, bundle, options));
    REQUIRE(thrown.bind("t", some));
    REQUIRE(thrown.run("spoil"));
    REQUIRE(thrown.leaf("p"));
    REQUIRE(thrown.leaf_view("p"));
    REQUIRE(thrown.run("look"));
    REQUIRE(thrown.output("look", "wide"));

    options.warn = {};
    auto silent = test::must(runtime::Program::load(device, bundle, options));
    said.clear();
    REQUIRE(silent.bind("t", some));
    REQUIRE(silent.run("spoil"));
    REQUIRE(silent.leaf("p"));
    CHECK(said.empty());
    CHECK(test::must(silent.told_not_finite("spoil")).size() == 1);

    auto judge =
        test::must(jit::ReferenceProgram::load(bundle, [&](const std::string& warning) { said.push_back(warning); }));
    tells(judge, said);
  });
}
// NOLINTEND(bugprone-use-after-move,clang-analyzer-cplusplus.Move)
