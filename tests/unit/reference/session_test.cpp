// SPDX-License-Identifier: Apache-2.0
// Sessions: steps and updates, symbols solved from data, and every message that a user may meet.
#include "tests/catch.h"
#include "tests/unit/reference/support.h"

namespace dr::reference_test {
namespace {

using reference::Session;

Image picture(int64_t w, int64_t h = 1, int64_t l = 1) { return reference::zeros(ir::kFloat, w, h, l); }

// Declares leaves only.
ir::Graph leaves(const std::string& declarations) { return parse(declarations); }

TEST_CASE("a step changes leaves when it ends, and counts its runs") {
  const ir::Graph graph = parse(R"(
    leaf x : float[N] param
    leaf m : float[N] state
    leaf c : vec2[N] state = [3, 4]
    %0 : float[N] = leaf text "x"
    %1 : float[N] = leaf text "m"
    %2 : int = step_index
    %3 : float = convert %2 ints [3]
    %4 : float[N] = add %0, %3
    %5 : float = const floats [9]
    %7 : float[N] = broadcast %5 dims [N, 1, 1]
    %6 : vec2[N] = leaf text "c"
    step swap {
      output before %0
      output c %6
      update x %1
      update m %4
    }
    step other {
      output index %2
      update m %7
    })");
  Session session(graph);
  REQUIRE(!session.bind("x", row("float", {1, 2})));
  const auto outputs = [&](const std::string& step) {
    auto result = session.run(step);
    if (const auto* error = std::get_if<reference::EvalError>(&result)) FAIL(error->message);
    return std::get<reference::StepResult>(result).outputs;
  };
  Images out = outputs("swap");
  CHECK(out.at("before").data == Numbers{1, 2});
  CHECK(out.at("c").data == Numbers{3, 3, 4, 4});
  CHECK(session.leaf("x").data == Numbers{0, 0});
  CHECK(session.leaf("m").data == Numbers{1, 2});
  outputs("swap");
  CHECK(session.leaf("x").data == Numbers{1, 2});
  CHECK(session.leaf("m").data == Numbers{1, 1});
  CHECK(outputs("other").at("index").data == Numbers{0});
  CHECK(session.leaf("m").data == Numbers{9, 9});
  CHECK(outputs("other").at("index").data == Numbers{1});
}

TEST_CASE("any root value can be evaluated") {
  const ir::Graph graph = parse(R"(
    leaf x : float[N] input
    %0 : float[N] = leaf text "x"
    %1 : float[N] = add %0, %0
    %2 : float = reduce_sum %1 ints [1, 1, 1])");
  Session session(graph);
  REQUIRE(!session.bind("x", row("float", {1, 2})));
  const auto& ops = graph.region(graph.root()).ops;
  const std::vector<ir::ValueId> values = {graph.op(ops[2]).results[0], graph.op(ops[0]).results[0],
                                           graph.op(ops[2]).results[0]};
  const auto result = session.evaluate(values);
  REQUIRE(std::holds_alternative<std::vector<Image>>(result));
  const auto& images = std::get<std::vector<Image>>(result);
  REQUIRE(images.size() == 3);
  CHECK(images[0].data == Numbers{6});
  CHECK(images[1].data == Numbers{1, 2});
  CHECK(images[2].data == Numbers{6});
  CHECK(std::get<std::vector<Image>>(session.evaluate({})).empty());
}

TEST_CASE("data give symbols their values") {
  const ir::Graph graph = leaves(R"(
    leaf photo : float[W, H] input
    leaf half : float[(W + 1) / 2, 2 * H - 1, N] input
    leaf pair : float[N * W + 1] input)");
  SECTION("one after the other") {
    Session session(graph);
    CHECK(!session.bind("photo", picture(5, 4)));
    CHECK(!session.bind("half", picture(3, 7, 2)));
    CHECK(!session.bind("pair", picture(11)));
    CHECK(session.symbols() == ir::SymbolValues{{"W", 5}, {"H", 4}, {"N", 2}});
    CHECK(!session.prepare());
  }
  SECTION("what cannot be solved yet waits") {
    Session session(graph);
    CHECK(!session.bind("pair", picture(11)));
    CHECK(!session.bind("half", picture(3, 7, 2)));
    // N is known now, and with it N * W + 1 = 11 gives W.
    CHECK(session.symbols() == ir::SymbolValues{{"H", 4}, {"N", 2}, {"W", 5}});
    CHECK(!session.bind("photo", picture(5, 4)));
  }
  SECTION("what waited may turn out to be wrong") {
    Session session(graph);
    CHECK(!session.bind("half", picture(3, 7, 2)));
    CHECK(session.bind("photo", picture(7, 4)) ==
          "input 'half' has width 3, expected (W + 1) / 2 = 4, where 'W' is 7 by input 'photo'");
    CHECK(!session.bind("photo", picture(6, 4)));
  }
}

TEST_CASE("extents that contradict each other") {
  const ir::Graph graph = leaves(R"(
    leaf photo : float[W, H] input
    leaf mask : float[W, H, 2] input
    leaf odd : float[2 * K + 1] param
    leaf wide : float[W + 2] state)");
  Session session(graph);
  REQUIRE(!session.bind("photo", picture(64, 48)));
  CHECK(session.bind("mask", picture(32, 48, 2)) == "'W' is 64 by input 'photo', but input 'mask' has width 32");
  CHECK(session.bind("mask", picture(64, 47, 2)) == "'H' is 48 by input 'photo', but input 'mask' has height 47");
  CHECK(session.bind("mask", picture(64, 48)) == "input 'mask' has number of layers 1, expected 2");
  CHECK(session.bind("odd", picture(4)) == "param 'odd' has width 4, but no 'K' makes '2 * K + 1' equal to that");
  CHECK(session.bind("wide", picture(64)) ==
        "state 'wide' has width 64, expected W + 2 = 66, where 'W' is 64 by input 'photo'");
  CHECK(session.bind_symbol("H", 7) == "'H' is 48 by input 'photo', but it is given as 7");
  CHECK(!session.bind_symbol("H", 48));
  CHECK(!session.bind_symbol("K", 3));
  CHECK(session.bind("odd", picture(5)) ==
        "param 'odd' has width 5, expected 2 * K + 1 = 7, where 'K' is 3 by the given value");
  // What was refused left no trace.
  CHECK(!session.bind("mask", picture(64, 48, 2)));
  CHECK(!session.bind("odd", picture(7)));
}

TEST_CASE("bind refuses what a leaf cannot hold") {
  const ir::Graph graph = leaves(R"(
    leaf face : ivec3[F] input
    leaf visible : bool[F] input)");
  Session session(graph);
  CHECK(session.bind("fase", picture(1)) == "there is no leaf 'fase'; there are: 'face' 'visible'");
  CHECK(session.bind("face", picture(1)) == "input 'face' is ivec3, but its data is float");
  CHECK(session.bind("face", image("vec3", 1, 1, 1, {0, 1, 1.5})) == "input 'face' is ivec3, but its data holds 1.5");
  CHECK(session.bind("visible", row("float", {0, 2})) == "input 'visible' is bool, but its data holds 2");
  CHECK(session.bind("face", Image{ir::vec(3), 1, 1, 1, {0}}) == "input 'face' has 1 numbers, its size asks for 3");
  CHECK(session.bind("face", Image{ir::vec(3), 0, 1, 1, {}}) == "input 'face' has width 0, at least 1 is expected");
  CHECK(!session.bind("face", image("vec3", 1, 1, 1, {0, 1, 2})));
  CHECK(session.leaf("face").type == ir::vec(3, ir::Scalar::Int));
}

TEST_CASE("what is missing is named") {
  const ir::Graph graph = parse(R"(
    leaf photo : float[W, H] input
    leaf m : float[K] state
    %0 : float[W, H] = leaf text "photo"
    %1 : float = const floats [1]
    %2 : float[M] = broadcast %1 dims [M, 1, 1]
    step s {
      output r %0
    }
    step t {
      output r %2
    })");
  Session session(graph);
  CHECK(std::get<reference::EvalError>(session.run("u")).message == "there is no step 'u'; there are: 's' 't'");
  CHECK(std::get<reference::EvalError>(session.run("s")).message ==
        "input 'photo' : float[W, H] has no data; bind it before the first step");
  REQUIRE(!session.bind("photo", picture(2, 2)));
  CHECK(session.prepare() ==
        "'K' has no value: the width 'K' of state 'm' needs it; bind a leaf whose extent is 'K', or give the symbol "
        "its value");
  REQUIRE(!session.bind_symbol("K", 3));
  CHECK(!session.prepare());
  CHECK(session.leaf("m").width == 3);
  CHECK(std::holds_alternative<reference::StepResult>(session.run("s")));
  CHECK(std::get<reference::EvalError>(session.run("t")).message ==
        "%2 has the extent 'M', whose value is not known: no leaf that is bound gives 'M' a value");
}

TEST_CASE("extents must be positive") {
  const ir::Graph graph = parse(R"(
    leaf x : float[W] input
    %0 : float = const floats [1]
    %inner.1 : float[W - 1] = broadcast %0 dims [W - 1, 1, 1]
    step s {
      output r %inner.1
    })");
  CHECK(run(graph, {{"x", picture(3)}}).at("r").data == Numbers{1, 1});
  CHECK(error(graph, {{"x", picture(1)}}).message ==
        "'inner' has the extent 'W - 1', which is 0; at least 1 is expected, where 'W' is 1");
}

TEST_CASE("a symbol that data do not determine") {
  const ir::Graph graph = leaves("leaf x : float[(W + 1) / 2] input");
  Session session(graph);
  REQUIRE(!session.bind("x", picture(3)));
  CHECK(session.symbols().empty());
  const auto message = session.prepare();
  REQUIRE(message.has_value());
  CHECK(message->find("'W' has no value: the width '(W + 1) / 2' of input 'x' does not determine it") == 0);
  REQUIRE(session.bind_symbol("W", 9).has_value());
  REQUIRE(!session.bind_symbol("W", 6));
  CHECK(!session.prepare());
}

}  // namespace
}  // namespace dr::reference_test
