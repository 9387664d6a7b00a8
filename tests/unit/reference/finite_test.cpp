// SPDX-License-Identifier: Apache-2.0
// Tracing a NaN or Inf to the op that made it.
#include <cmath>

#include "tests/catch.h"
#include "tests/unit/reference/support.h"

namespace dr::reference_test {
namespace {

reference::Options checked(reference::CheckFinite check = reference::CheckFinite::Results) {
  reference::Options options;
  options.check_finite = check;
  return options;
}

const std::string_view kShielded = R"(
  leaf x : float[W, H] input
  %0 : float[W, H] = leaf text "x"
  %root.1 : float[W, H] = sqrt %0
  %2 : float = const floats [0]
  %3 : bool[W, H] = le %2, %0
  %4 : float[W, H] = select %3, %root.1, %2
  step s {
    output r %OUT
  })";

std::string with_output(std::string_view text, const std::string& value) {
  std::string out(text);
  out.replace(out.find("%OUT"), 4, value);
  return out;
}

TEST_CASE("a NaN that reaches a result is traced to the op that made it") {
  const Images leaves{{"x", image("float", 3, 2, 1, {1, 4, 9, 16, -1, 0})}};
  CHECK(error(parse(with_output(kShielded, "%root.1")), leaves, checked()).message ==
        "'sqrt' makes a NaN or Inf of finite operands: 'root' at element (1, 1, 0), and it reaches a result");
  CHECK(run(parse(with_output(kShielded, "%4")), leaves, checked()).at("r").data == Numbers{1, 2, 3, 4, 0, 0});
}

TEST_CASE("leaves and constants are named as such") {
  const Images leaves{{"x", image("float", 2, 1, 1, {1, kInfinity})}};
  CHECK(error(parse(with_output(kShielded, "%4")), leaves, checked()).message ==
        "input 'x' holds a NaN or Inf at element (1, 0, 0), and it reaches a result");
  const ir::Graph constant = parse(R"(
    %0 : float = const floats [inf]
    %1 : float = sqrt %0
    step s {
      output r %1
    })");
  CHECK(error(constant, {}, checked()).message == "the constant %0 is NaN or Inf, and it reaches a result");
}

const std::string_view kRegion = R"(
  leaf x : float[W] input
  leaf n : int[W] input
  %0 : float[W] = leaf text "x"
  %1 : int[W] = leaf text "n"
  %2 : float = const floats [0]
  %3 : int = const floats [0]
  %4 : bool[W] = lt %2, %0
  %5 : float[W], %6 : float[2] = if %4 dims [W, 1, 1, 2, 1, 1] yields [element, scatter] {
    %deep.7 : float[W] = log %0
    %8 : float[W] = reduce %3, %1 ints [-1] dims [W, 1, 1] yields [min] (%9 : int[W]) {
      %10 : float[W] = convert %9 ints [3]
      %11 : float[W] = add %10, %deep.7
      yield %11
    }
    yield %8, %3, %deep.7
  } {
    %bad.12 : float[W] = log %0
    yield %bad.12, %3, %2
  }
  step s {
    output r %OUT
  })";

TEST_CASE("tracing inside regions") {
  // The branch not taken makes nothing.
  CHECK(run(parse(with_output(kRegion, "%5")), {{"x", row("float", {1, 1})}, {"n", row("int", {2, 1})}}, checked())
            .at("r")
            .data == Numbers{0, 0});
  CHECK(error(parse(with_output(kRegion, "%5")), {{"x", row("float", {1, -1})}, {"n", row("int", {2, 1})}}, checked())
            .message ==
        "'log' makes a NaN or Inf of finite operands: 'bad' at element (1, 0, 0), and it reaches a result");
  // An empty minimum is an infinity that the reduce makes; the other result has none.
  CHECK(error(parse(with_output(kRegion, "%5")), {{"x", row("float", {1, 1})}, {"n", row("int", {2, 0})}}, checked())
            .message ==
        "'reduce' makes a NaN or Inf of finite operands: %9 at element (1, 0, 0), and it reaches a result");
  CHECK(run(parse(with_output(kRegion, "%6")), {{"x", row("float", {1, 1})}, {"n", row("int", {2, 0})}}, checked())
            .at("r")
            .data == Numbers{0, 0});
  CHECK(error(parse(with_output(kRegion, "%6")), {{"x", row("float", {1, kInfinity})}, {"n", row("int", {1, 1})}},
              checked())
            .message == "input 'x' holds a NaN or Inf at element (1, 0, 0), and it reaches a result");
}

TEST_CASE("an update that would not be finite changes nothing") {
  const ir::Graph graph = parse(R"(
    leaf x : float param = [1000]
    %0 : float = leaf text "x"
    %1 : float = exp %0
    step s {
      update x %1
    })");
  reference::Session session(graph);
  CHECK(std::holds_alternative<reference::EvalError>(session.run("s", checked())));
  CHECK(session.leaf("x").data == Numbers{1000});
}

TEST_CASE("the first NaN of all is found where it would be shielded") {
  const auto all = checked(reference::CheckFinite::All);
  const Images leaves{{"x", image("float", 3, 2, 1, {1, 4, 9, 16, -1, 0})}};
  const reference::EvalError found = error(parse(with_output(kShielded, "%4")), leaves, all);
  CHECK(found.message == "'sqrt' makes a NaN or Inf of finite operands: 'root' at element (1, 1, 0)");
  CHECK(found.notes == std::vector<std::string>{"operand %0 is -1", "in run 1 of step 's'"});
  CHECK(error(parse(with_output(kRegion, "%6")), {{"x", row("float", {1, -1})}, {"n", row("int", {2, 1})}}, all)
            .message == "'log' makes a NaN or Inf of finite operands: 'bad' at element (1, 0, 0)");
  CHECK(run(parse(with_output(kRegion, "%6")), {{"x", row("float", {1, 1})}, {"n", row("int", {2, 1})}}, all)
            .at("r")
            .data == Numbers{0, 0});
}

TEST_CASE("finite numbers may scatter to an infinity") {
  const ir::Graph graph = parse(R"(
    leaf x : vec2[W] input
    %0 : vec2[W] = leaf text "x"
    %1 : bool = const floats [1]
    %2 : int = const floats [1]
    %3 : vec2[3] = if %1 dims [W, 1, 1, 3, 1, 1] yields [scatter] {
      yield %2, %0
    } {
      yield %2, %0
    }
    step s {
      output r %3
    })");
  CHECK(error(graph, {{"x", image("vec2", 2, 1, 1, {1, 2, 1.7e308, 1.7e308})}}, checked(reference::CheckFinite::All))
            .message == "'if' makes a NaN or Inf of finite operands: %3 at element (1, 0, 0)");
}

TEST_CASE("what is found does not depend on threads") {
  // Each of many batches has its own NaN.
  Image x = reference::zeros(ir::kFloat, 5000, 1, 1), n = reference::zeros(ir::kInt, 5000, 1, 1);
  n.data.assign(n.data.size(), 1);
  for (size_t i = 0; i < x.data.size(); ++i) x.data[i] = i % 700 == 699 ? -1 : 1;
  for (const int threads : {1, 2, 7}) {
    auto options = checked(reference::CheckFinite::All);
    options.threads = threads;
    CHECK(error(parse(with_output(kRegion, "%5")), {{"x", x}, {"n", n}}, options).message.find("(699, 0, 0)") !=
          std::string::npos);
  }
}

}  // namespace
}  // namespace dr::reference_test
