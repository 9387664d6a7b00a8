// SPDX-License-Identifier: Apache-2.0
// What the verifier refuses, one violation a text, and what it accepts.
#include <algorithm>
#include <random>

#include "compiler/passes/passes.h"
#include "tests/sanitized.h"
#include "tests/unit/passes/random_graph.h"
#include "tests/unit/passes/text.h"

using namespace dr::ir;
using dr::passes::verify;
using dr::passes_test::read;

namespace {

// What every text below starts with.
constexpr std::string_view kPreamble = R"(leaf x : float[W, H] input
leaf p : vec3 param = [1, 2, 3]
%0 : float[W, H] = leaf text "x"
%1 : vec3 = leaf text "p"
%2 : bool = const floats [1]
%3 : int = const floats [2]
%4 : float = const floats [2]
)";

std::string violations(std::string_view text) {
  std::string out;
  for (const std::string& violation : verify(read(std::string(kPreamble) + std::string(text)))) out += violation + "\n";
  return out;
}

}  // namespace

TEST_CASE("sound graphs have no violations") {
  CHECK(violations("") == "");
  CHECK(violations(R"(%9 : float[W, H], %10 : float[7] = if %2 dims [W, H, 1, 7, 1, 1] yields [element, scatter] {
  %5 : float[W, H] = neg %0
  %6 : float = gather %4, %3
  yield %5, %3, %6
} {
  %8 : accumulation float[7] = reduce %3, %3 ints [-1] dims [W, H, 1, 7, 1, 1] yields [scatter] (%7 : int[W, H]) {
    yield %7, %4
  }
  yield %4, %8
}
step s {
  output a %9
  output b %10
  update p %1
}
)") == "");
}

TEST_CASE("random graphs are sound") {
  for (uint64_t seed = 0; seed < 200; ++seed) {
    const auto found = verify(dr::passes_test::random_graph(seed));
    CAPTURE(seed, found);
    REQUIRE(found.empty());
  }
}

TEST_CASE("values must be visible where they are used") {
  CHECK(violations(R"(%6 : float[W, H] = if %2 dims [W, H, 1] yields [element] {
  %5 : float[W, H] = neg %0
  yield %5
} {
  yield %0
}
%7 : float[W, H] = neg %5
)") == "value %5 is not defined before its use in this or an enclosing region: %7 : float[W, H] = neg %5\n");
  CHECK(violations(R"(%6 : float[W, H] = if %2 dims [W, H, 1] yields [element] {
  %5 : float[W, H] = neg %0
  yield %5
} {
  yield %5
}
)") == "value %5 is not defined before its use in this or an enclosing region: %6 : float[W, H] = if %2 dims [W, H, 1] "
       "yields [element]\n");
}

TEST_CASE("every violation is listed, of structure or else of types") {
  CHECK(violations("%5 : vec3 = add %0, %1\n%6 : float = neg %4 {\n  yield\n}\n= neg %4\n") ==
        "expected 0 regions, found 1: %6 : float = neg %4\nexpected 1 results, found 0: = neg %4\n");
  CHECK(violations("%5 : int = neg %0\n%6 : int = neg %4\n") ==
        "result %5 should be float[W, H]: %5 : int = neg %0\nresult %6 should be float: %6 : int = neg %4\n");
}

TEST_CASE("ops have their regions, parameters, yields and results") {
  CHECK(violations("%5 : float = neg %4 {\n  yield\n}\n") == "expected 0 regions, found 1: %5 : float = neg %4\n");
  CHECK(violations("%5 : float = if %2 dims [1, 1, 1] yields [element] {\n  yield %4\n}\n") ==
        "expected 2 regions, found 1: %5 : float = if %2 dims [1, 1, 1] yields [element]\n");
  CHECK(violations("= if %2 dims [1, 1, 1] {\n  yield\n} {\n  yield\n}\n") ==
        "an op has at least one result: = if %2 dims [1, 1, 1]\n");
  CHECK(violations("= neg %4\n") == "expected 1 results, found 0: = neg %4\n");
  CHECK(
      violations("%5 : float = reduce %3, %3 ints [-1] dims [1, 1, 1] yields [sum] {\n  yield %4\n}\n") ==
      "expected 1 parameters of a region, found 0: %5 : float = reduce %3, %3 ints [-1] dims [1, 1, 1] yields [sum]\n");
  CHECK(violations(
            "%6 : float = reduce %3, %3 ints [-1] dims [1, 1, 1] yields [sum] (%5 : int) {\n  yield %4, %4\n}\n") ==
        "expected 1 yields of a region, found 2: %6 : float = reduce %3, %3 ints [-1] dims [1, 1, 1] yields [sum]\n");
  CHECK(violations("%6 : float[7] = reduce %3, %3 ints [-1] dims [1, 1, 1] yields [scatter] (%5 : int) {\n  yield %5, "
                   "%4\n}\n") ==
        "expected 6 dims, found 3: %6 : float[7] = reduce %3, %3 ints [-1] dims [1, 1, 1] yields [scatter]\n");
  CHECK(violations(
            "%6 : float = reduce %3, %3 ints [-1] dims [1, 1, 1] yields [element] (%5 : int) {\n  yield %4\n}\n") ==
        "a reduce combines what its trips yield, 'element' does not say how: %6 : float = reduce %3, %3 ints [-1] dims "
        "[1, 1, 1] yields "
        "[element]\n");
  CHECK(violations("%5 : float = if %2 dims [1, 1, 1] yields [sum] {\n  yield %4\n} {\n  yield %4\n}\n") ==
        "an if yields elements and scatters only: %5 : float = if %2 dims [1, 1, 1] yields [sum]\n");
  CHECK(violations("%5 : float = grad %4, %4\n") ==
        "a grad has a value, a seed and at least one target: %5 : float = grad %4, %4\n");
  CHECK(violations("%5 : int, %6 : int = raster %4 ints [1, 0, 5] dims [W, H, 1, F]\n")
            .starts_with("expected 3 regions, found 0"));
}

TEST_CASE("only element-wise ops stand in regions") {
  const auto in_region = [](const std::string& line) {
    return violations("%9 : float = if %2 dims [W, H, 1] yields [element] {\n" + line +
                      "  yield %4\n} {\n  yield %4\n}\n");
  };
  CHECK(in_region("  %5 : float = reduce_sum %0 ints [1, 1, 1]\n") ==
        "this op may not stand in a region: %5 : float = reduce_sum %0 ints [1, 1, 1]\n");
  CHECK(in_region("  %5 : float = grad %4, %4, %4\n") ==
        "this op may not stand in a region: %5 : float = grad %4, %4, %4\n");
  CHECK(in_region("  %5 : float = neg %4\n  %6 : float = gather %5, %3\n") ==
        "a gather inside a region reads a value that is not of the root region: %6 : float = gather %5, %3\n");
}

TEST_CASE("accumulations are only yielded on as scatters") {
  const auto with = [](const std::string& rest, const std::string& yield, const std::string& kind,
                       const std::string& dims) {
    return violations("%9 : float[7] = reduce %3, %3 ints [-1] dims [1, 1, 1" + dims + "] yields [" + kind +
                      "] (%5 : int) {\n" +
                      "  %7 : accumulation float[7] = reduce %3, %3 ints [-1] dims [1, 1, 1, 7, 1, 1] yields [scatter] "
                      "(%6 : int) {\n" +
                      "    yield %6, %4\n  }\n" + rest + "  yield " + yield + "\n}\n");
  };
  CHECK(with("", "%7", "scatter", ", 7, 1, 1") == "");
  CHECK(with("  %8 : float[7] = neg %7\n", "%7", "scatter", ", 7, 1, 1") ==
        "accumulation %7 may only be yielded on: %8 : float[7] = neg %7\n");
  CHECK(with("", "%7", "sum", "").starts_with("accumulation %7 may only be yielded as a scatter: "));
  CHECK(with("", "%5, %7", "scatter", ", 7, 1, 1").starts_with("accumulation %7 is scattered as a value: "));
  CHECK(with("", "%7", "scatter", ", 8, 1, 1").find("accumulation %7 is float[7], the result float[7]") ==
        std::string::npos);
  CHECK(violations("%6 : accumulation float = neg %4\n") ==
        "only a scatter inside a region is an accumulation: %5 : accumulation float = neg %4\n");
}

TEST_CASE("leaves, steps and updates") {
  CHECK(violations("leaf x : float input\n") == "two leaves are named 'x'\n");
  CHECK(violations("leaf y : vec2 input = [1]\n") == "leaf 'y' is vec2 and has 1 initial components\n");
  CHECK(violations("%5 : float = leaf text \"z\"\n").starts_with("there is no leaf 'z': "));
  CHECK(violations("%5 : float = leaf text \"x\"\n").starts_with("result %5 should be float[W, H]: "));
  CHECK(violations("step a {\n}\nstep a {\n}\n") == "two steps are named 'a'\n");
  CHECK(violations("step a {\n  output o %0\n  output o %1\n}\n") == "step 'a': two outputs are named 'o'\n");
  CHECK(violations("step a {\n  update p %1\n  update p %1\n}\n") == "step 'a': leaf 'p' has two writers\n");
  CHECK(violations("step a {\n  update x %4\n}\n") ==
        "step 'a': leaf 'x' is float[W, H] and its new value %4 is float\n");
  CHECK(violations("%6 : float = if %2 dims [1, 1, 1] yields [element] {\n  %5 : float = neg %4\n  yield %5\n} {\n  "
                   "yield %4\n}\n"
                   "step a {\n  output o %5\n}\n") == "step 'a': output 'o', %5, is not of the root region\n");
}

TEST_CASE("types and extents follow the op table") {
  CHECK(violations("%5 : vec3 = add %0, %1\n").find(": %5 : vec3 = add %0, %1\n") != std::string::npos);
  CHECK(violations("%5 : float[W] = neg %0\n") == "result %5 should be float[W, H]: %5 : float[W] = neg %0\n");
  CHECK(violations("%5 : int = neg %0\n") == "result %5 should be float[W, H]: %5 : int = neg %0\n");
}

TEST_CASE("what stands in a region stretches to its domain") {
  const std::string found = violations(
      "%6 : float[W] = if %2 dims [W, 1, 1] yields [element] {\n  %5 : float[W, H] = neg %0\n  yield %5\n} {\n  yield "
      "%4\n}\n");
  CHECK(found.starts_with("the extent does not stretch to the region's domain, [W]: %5 : float[W, H] = neg %0\n"));
  CHECK(violations("%5 : float[W] = if %2 dims [W, 1, 1] yields [element] {\n  yield %0\n} {\n  yield %4\n}\n")
            .find("float[W, H] does not stretch to the domain, [W]: ") != std::string::npos);
}

namespace {

// A word that may stand where `word` does, as far as the parser is concerned.
std::string other_word(const std::string& word, std::mt19937_64& random) {
  static const std::vector<std::string> kTypes = {"float", "int", "bool", "uint", "vec3", "ivec2", "mat3"};
  static const std::vector<std::string> kNumbers = {
      "0", "1", "-1", "2", "3", "4", "9", "1000000007", "9223372036854775807"};
  static const std::vector<std::string> kYields = {"element", "sum", "min", "max", "argmin", "scatter"};
  const auto any = [&](const std::vector<std::string>& words) { return words[random() % words.size()]; };
  if (word.starts_with('%')) return std::string("%") + std::to_string(random() % 40);
  if (op_kind(word)) {
    const auto kinds = all_op_kinds();
    return std::string(op_name(kinds[random() % kinds.size()]));
  }
  if (Type::parse(word)) return random() % 8 == 0 ? "accumulation float" : any(kTypes);
  if (std::find(kYields.begin(), kYields.end(), word) != kYields.end()) return any(kYields);
  if (!word.empty() && word[0] >= '0' && word[0] <= '9') return random() % 8 == 0 ? word + ", 1" : any(kNumbers);
  return "";
}

}  // namespace

TEST_CASE("damaged graphs are refused or sound, and simplify keeps the sound ones so") {
  std::mt19937_64 random(7);
  constexpr std::string_view kSeparators = " ,[]\n";
  int parsed_count = 0, sound = 0;
  for (int i = 0; i < dr::repeats(4000); ++i) {
    std::string text = print(dr::passes_test::random_graph(random() % 100));
    for (uint64_t k = random() % 3; k < 3; ++k) {
      const size_t begin = text.find_first_of(kSeparators, random() % text.size()) + 1;
      const size_t end = text.find_first_of(kSeparators, begin);
      if (begin == 0 || end == std::string::npos) continue;
      text.replace(begin, end - begin, other_word(text.substr(begin, end - begin), random));
    }
    auto parsed = parse(text);
    if (!std::holds_alternative<Graph>(parsed)) continue;
    ++parsed_count;
    CAPTURE(i, text);
    const Graph& graph = std::get<Graph>(parsed);
    if (!verify(graph).empty()) continue;
    ++sound;
    REQUIRE(verify(dr::passes::simplify(graph)) == std::vector<std::string>{});
  }
  CHECK(parsed_count > dr::repeats(500));
  CHECK(sound > dr::repeats(100));
}

TEST_CASE("a region that belongs to no op") {
  Builder b;
  b.begin_region({});
  b.end_region({});
  CHECK(verify(b.graph()) == std::vector<std::string>{"region 1 belongs to no op"});
}
