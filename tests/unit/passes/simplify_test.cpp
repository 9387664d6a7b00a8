// SPDX-License-Identifier: Apache-2.0
// What `simplify` does and what it leaves alone, text in, text out.
#include <chrono>

#include "compiler/ops/emit.h"
#include "compiler/passes/passes.h"
#include "tests/unit/passes/text.h"

using namespace dr::ir;
using dr::passes::simplify;
using dr::passes::verify;
using dr::passes_test::read;

namespace {

constexpr std::string_view kLeaves = R"(leaf x : float[W, H] input
leaf v : vec3[W, H] input
leaf c : bool input
leaf n : int input
)";

// The leaves as values: %x.0, %v.1, %c.2, %n.3; the text goes on at %4.
constexpr std::string_view kReads = R"(%x.0 : float[W, H] = leaf text "x"
%v.1 : vec3[W, H] = leaf text "v"
%c.2 : bool = leaf text "c"
%n.3 : int = leaf text "n"
)";

// All of the leaves are outputs, so that their numbers stay; `outputs` are further ones.
std::string program(std::string_view ops, const std::vector<std::string>& outputs) {
  std::string text = std::string(kLeaves) + std::string(kReads) + std::string(ops) + "step s {\n";
  for (const char* leaf : {"%x.0", "%v.1", "%c.2", "%n.3"})
    text += "  output " + std::string(leaf + 1, 1) + " " + leaf + "\n";
  for (size_t i = 0; i < outputs.size(); ++i) text += "  output out" + std::to_string(i) + " " + outputs[i] + "\n";
  return text + "}\n";
}

void check(std::string_view before, const std::vector<std::string>& outputs, std::string_view after,
           const std::vector<std::string>& simplified_outputs) {
  const Graph graph = read(program(before, outputs));
  REQUIRE(verify(graph) == std::vector<std::string>{});
  const Graph simpler = simplify(graph);
  CHECK(verify(simpler) == std::vector<std::string>{});
  CHECK(print(simpler) == program(after, simplified_outputs));
}

void check_kept(std::string_view text, const std::vector<std::string>& outputs) { check(text, outputs, text, outputs); }

// One op on the leaves and constants that becomes a leaf or a value that is there already.
void check_becomes(std::string_view before, const std::string& result) {
  INFO(before);
  check(before, {"%9"}, "", {result});
}

}  // namespace

TEST_CASE("dead ops go, leaves stay declared") { check("%4 : float[W, H] = neg %0\n", {}, "", {}); }

TEST_CASE("integers that an if moves are selected") {
  check(
      "%6 : ivec2 = if %2 dims [1, 1, 1] yields [element] {\n  %4 : ivec2 = compose %3, %3 ints [2, 1]\n  yield %4\n} "
      "{\n"
      "  %5 : ivec2 = const floats [1, 2]\n  yield %5\n}\n",
      {"%6"},
      "%4 : ivec2 = compose %n.3, %n.3 ints [2, 1]\n%5 : ivec2 = const floats [1, 2]\n"
      "%6 : ivec2 = select %c.2, %4, %5\n",
      {"%6"});
  check(
      "%4 : int = const floats [1]\n%5 : ivec2 = compose %4, %3 ints [2, 1]\n%6 : ivec2 = compose %3, %4 ints [2, 1]\n"
      "%7 : ivec2 = select %2, %5, %6\n%8 : int = extract %7 ints [0]\n",
      {"%8"}, "%4 : int = const floats [1]\n%5 : int = select %c.2, %4, %n.3\n", {"%5"});
}

TEST_CASE("a read at one of two places is one of two reads that are there") {
  const std::string reads =
      "%4 : ivec2 = compose %n.3, %n.3 ints [2, 1]\n%5 : float = gather %x.0, %4\n%6 : ivec2 = const floats [1, 2]\n";
  const std::string both = reads + "%7 : float = gather %x.0, %6\n";
  check(both + "%8 : ivec2 = select %2, %4, %6\n%9 : float = gather %0, %8\n", {"%5", "%7", "%9"},
        both + "%8 : float = select %c.2, %5, %7\n", {"%5", "%7", "%8"});
  check_kept(reads + "%7 : ivec2 = select %c.2, %4, %6\n%8 : float = gather %x.0, %7\n", {"%5", "%8"});
}

TEST_CASE("equal ops become one") {
  check("%4 : float[W, H] = sin %0\n%5 : float[W, H] = sin %0\n%6 : float[W, H] = add %4, %5\n", {"%6", "%5"},
        "%4 : float[W, H] = sin %x.0\n%5 : float[W, H] = add %4, %4\n", {"%5", "%4"});
  // Either order of operands, and names survive.
  check("%4 : float[W, H] = sin %0\n%5 : float[W, H] = mul %0, %4\n%late.6 : float[W, H] = mul %4, %0\n", {"%5", "%6"},
        "%4 : float[W, H] = sin %x.0\n%late.5 : float[W, H] = mul %x.0, %4\n", {"%late.5", "%late.5"});
  check_kept("%4 : float[W, H] = sin %x.0\n%5 : float[W, H] = sub %x.0, %4\n%6 : float[W, H] = sub %4, %x.0\n",
             {"%5", "%6"});
  // Attributes count, the zeros differ.
  check_kept("%4 : float[W, H] = shift %x.0 ints [1, 0]\n%5 : float[W, H] = shift %x.0 ints [0, 1]\n", {"%4", "%5"});
  check_kept("%4 : float = const floats [0]\n%5 : float = const floats [-0]\n%6 : float = const floats [nan]\n",
             {"%4", "%5", "%6"});
  check("%4 : float = const floats [nan]\n%5 : float = const floats [nan]\n", {"%4", "%5"},
        "%4 : float = const floats [nan]\n", {"%4", "%4"});
}

TEST_CASE("identities") {
  check_becomes("%4 : float = const floats [1]\n%9 : float[W, H] = mul %0, %4\n", "%x.0");
  check_becomes("%4 : float = const floats [1]\n%9 : float[W, H] = mul %4, %0\n", "%x.0");
  check_becomes("%4 : vec3 = const floats [1, 1, 1]\n%9 : vec3[W, H] = mul %1, %4\n", "%v.1");
  check_becomes("%4 : float = const floats [0]\n%9 : float[W, H] = add %4, %0\n", "%x.0");
  check_becomes("%4 : float = const floats [-0]\n%9 : float[W, H] = add %0, %4\n", "%x.0");
  check_becomes("%4 : float = const floats [0]\n%9 : float[W, H] = sub %0, %4\n", "%x.0");
  check_becomes("%4 : float = const floats [1]\n%9 : float[W, H] = div %0, %4\n", "%x.0");
  check_becomes("%4 : float[W, H] = neg %0\n%9 : float[W, H] = neg %4\n", "%x.0");
  check_becomes("%4 : bool = lnot %2\n%9 : bool = lnot %4\n", "%c.2");
  check_becomes("%4 : bool = const floats [1]\n%9 : bool = land %2, %4\n", "%c.2");
  check_becomes("%4 : bool = const floats [0]\n%9 : bool = lor %4, %2\n", "%c.2");
  check_becomes("%4 : bool = const floats [1]\n%5 : float[W, H] = neg %0\n%9 : float[W, H] = select %4, %0, %5\n",
                "%x.0");
  check_becomes("%4 : bool = const floats [0]\n%5 : float[W, H] = neg %0\n%9 : float[W, H] = select %4, %5, %0\n",
                "%x.0");
  check_becomes("%9 : float[W, H] = select %2, %0, %0\n", "%x.0");
  check_becomes("%9 : float[W, H] = convert %0 ints [3]\n", "%x.0");
  check_becomes("%9 : float[W, H] = broadcast %0 dims [W, H, 1]\n", "%x.0");
  check_becomes("%9 : float[W, H] = shift %0 ints [0, 0]\n", "%x.0");
  check_becomes("%9 : float[W, H] = reduce_sum %0 ints [0, 0, 1]\n", "%x.0");
  check_becomes("%9 : int = reduce_max %3 ints [1, 1, 1]\n", "%n.3");
  check_becomes("%4 : vec3[W, H] = splat %0 ints [3]\n%9 : float[W, H] = extract %4 ints [1]\n", "%x.0");
  check_becomes("%4 : vec2[W, H] = compose %0, %0 ints [2, 1]\n%9 : float[W, H] = extract %4 ints [1]\n", "%x.0");
  check_becomes(
      "%4 : float[W, H] = extract %1 ints [0]\n%5 : float[W, H] = extract %1 ints [1]\n%6 : float[W, H] = extract %1 "
      "ints [2]\n"
      "%9 : vec3[W, H] = compose %4, %5, %6 ints [3, 1]\n",
      "%v.1");

  check("%4 : float[W, H] = neg %0\n%5 : float[W, H] = sin %0\n%6 : float[W, H] = add %4, %5\n", {"%6"},
        "%4 : float[W, H] = sin %x.0\n%5 : float[W, H] = sub %4, %x.0\n", {"%5"});
  check("%4 : float = const floats [-1]\n%5 : float[W, H] = mul %0, %4\n", {"%5"}, "%4 : float[W, H] = neg %x.0\n",
        {"%4"});
  check("%4 : float[W] = reduce_sum %0 ints [0, 1, 1]\n", {"%4"}, "%4 : float[W] = reduce_sum %x.0 ints [0, 1, 0]\n",
        {"%4"});
  check("%4 : int = const floats [0]\n%5 : int = mul %3, %4\n", {"%5"}, "%4 : int = const floats [0]\n", {"%4"});
}

TEST_CASE("smul with a constant") {
  check("%4 : float = const floats [2]\n%5 : float[W, H] = smul %0, %4\n", {"%5"},
        "%4 : float = const floats [2]\n%5 : float[W, H] = mul %x.0, %4\n", {"%5"});
  check("%4 : float = const floats [2]\n%5 : float[W, H] = smul %4, %0\n", {"%5"},
        "%4 : float = const floats [2]\n%5 : float[W, H] = mul %4, %x.0\n", {"%5"});
  check_becomes("%4 : float = const floats [1]\n%9 : float[W, H] = smul %4, %0\n", "%x.0");
  // The zero keeps its extent, and vanishes where it is added.
  check("%4 : float = const floats [0]\n%5 : float[W, H] = smul %4, %0\n", {"%5"},
        "%4 : float = const floats [0]\n%5 : float[W, H] = broadcast %4 dims [W, H, 1]\n", {"%5"});
  check_becomes("%4 : float = const floats [0]\n%5 : float[W, H] = smul %4, %0\n%9 : float[W, H] = add %0, %5\n",
                "%x.0");
  check_kept("%4 : float = const floats [inf]\n%5 : float[W, H] = smul %x.0, %4\n", {"%5"});
  check_kept("%4 : float = const floats [1e+39]\n%5 : float[W, H] = smul %x.0, %4\n", {"%5"});
}

TEST_CASE("what changes results stays") {
  check_kept("%4 : float[W, H] = sub %x.0, %x.0\n", {"%4"});
  check_kept("%4 : float[W, H] = div %x.0, %x.0\n", {"%4"});
  check_kept("%4 : float = const floats [0]\n%5 : float[W, H] = mul %x.0, %4\n", {"%5"});
  check_kept("%4 : float[W, H] = detach %x.0\n%5 : float[W, H] = pin %4\n", {"%5"});
  check_kept("%4 : vec3 = const floats [1, 1, 0]\n%5 : vec3[W, H] = mul %v.1, %4\n", {"%5"});
  check_kept(
      "%4 : float[W, H] = extract %v.1 ints [0]\n%5 : float[W, H] = extract %v.1 ints [2]\n%6 : vec2[W, H] = compose "
      "%4, %5 ints [2, 1]\n",
      {"%6"});
}

TEST_CASE("constants fold where every device computes the same") {
  const auto folds = [](const std::string& ops, const std::string& last, const std::string& constant) {
    INFO(ops);
    check(ops, {last}, "%4 : " + constant + "\n", {"%4"});
  };
  folds(
      "%4 : float = const floats [1.5]\n%5 : float = const floats [2]\n%6 : float = mul %4, %5\n%7 : float = sub %6, "
      "%5\n",
      "%7", "float = const floats [1]");
  folds("%4 : int = const floats [7]\n%5 : int = const floats [2]\n%6 : int = div %4, %5\n", "%6",
        "int = const floats [3]");
  folds("%4 : float = const floats [7.5]\n%5 : int = convert %4 ints [1]\n", "%5", "int = const floats [7]");
  folds("%4 : float = const floats [1]\n%5 : float = const floats [2]\n%6 : bool = lt %4, %5\n", "%6",
        "bool = const floats [1]");
  folds("%4 : float = const floats [1]\n%5 : vec3 = splat %4 ints [3]\n", "%5", "vec3 = const floats [1, 1, 1]");
  // Operands are what the device has of them, and so is the result.
  folds("%4 : float = const floats [0.1]\n%5 : float = neg %4\n", "%5", "float = const floats [-0.10000000149011612]");
  folds("%4 : float = const floats [16777216]\n%5 : float = const floats [1]\n%6 : float = add %4, %5\n", "%6",
        "float = const floats [16777216]");
  folds("%4 : float = const floats [0.1]\n%5 : float = const floats [0.10000000149011612]\n%6 : bool = eq %4, %5\n",
        "%6", "bool = const floats [1]");

  check_kept("%4 : float = const floats [2]\n%5 : float = sin %4\n", {"%5"});
  check_kept("%4 : float = const floats [3]\n%5 : float = const floats [2]\n%6 : float = div %5, %4\n", {"%6"});
  check_kept("%4 : float = const floats [1e+30]\n%5 : float = mul %4, %4\n", {"%5"});
  check_kept("%4 : float = const floats [1e-30]\n%5 : float = mul %4, %4\n", {"%5"});
  check_kept("%4 : float = const floats [2]\n%5 : float = pin %4\n%6 : float[W, H] = mul %x.0, %5\n", {"%6"});
}

TEST_CASE("element-wise ops stretch by themselves") {
  check(
      "%4 : float = convert %3 ints [3]\n%5 : float[W, H] = broadcast %4 dims [W, H, 1]\n%6 : float[W, H] = max %5, "
      "%0\n",
      {"%6"}, "%4 : float = convert %n.3 ints [3]\n%5 : float[W, H] = max %4, %x.0\n", {"%5"});
  // One of two has to keep the extent.
  check_kept(
      "%4 : float = convert %n.3 ints [3]\n%5 : float[W, H] = broadcast %4 dims [W, H, 1]\n%6 : float[W, H] = max %4, "
      "%5\n",
      {"%6"});
  check(
      "%4 : float = convert %3 ints [3]\n%5 : float[W] = broadcast %4 dims [W, 1, 1]\n%6 : float[W, H] = broadcast %5 "
      "dims [W, H, 1]\n",
      {"%6"}, "%4 : float = convert %n.3 ints [3]\n%5 : float[W, H] = broadcast %4 dims [W, H, 1]\n", {"%5"});
}

TEST_CASE("an if with a constant condition is its branch") {
  check(R"(%4 : bool = const floats [0]
%7 : float[W, H], %8 : float[W, H] = if %4 dims [W, H, 1] yields [element, element] {
  %5 : float[W, H] = sin %0
  yield %5, %5
} {
  %6 : float[W, H] = cos %0
  %9 : float = convert %3 ints [3]
  yield %6, %9
}
)",
        {"%7", "%8"},
        "%4 : float[W, H] = cos %x.0\n%5 : float = convert %n.3 ints [3]\n%6 : float[W, H] = broadcast %5 dims [W, H, "
        "1]\n",
        {"%4", "%6"});
}

TEST_CASE("an inlined branch scatters once per element of the domain") {
  check(R"(%4 : bool = const floats [1]
%5 : float = const floats [2]
%6 : float[7] = if %4 dims [W, H, 1, 7, 1, 1] yields [scatter] {
  yield %3, %5
} {
  yield %3, %5
}
)",
        {"%6"}, R"(%4 : float = const floats [2]
%5 : float[W, H] = broadcast %4 dims [W, H, 1]
%6 : float[7] = scatter_add %n.3, %5 dims [7, 1, 1]
)",
        {"%6"});
  // Inside a region, the outer op scatters it.
  check(R"(%4 : bool = const floats [1]
%7 : float[7] = if %2 dims [W, H, 1, 7, 1, 1] yields [scatter] {
  %5 : accumulation float[7] = if %4 dims [W, H, 1, 7, 1, 1] yields [scatter] {
    yield %3, %0
  } {
    yield %3, %0
  }
  yield %5
} {
  yield %3, %0
}
)",
        {"%7"}, R"(%4 : float[7] = if %c.2 dims [W, H, 1, 7, 1, 1] yields [scatter] {
  yield %n.3, %x.0
} {
  yield %n.3, %x.0
}
)",
        {"%4"});
}

TEST_CASE("an inner op that scatters for each element of a larger domain stays inside") {
  check_kept(R"(%4 : bool = const floats [1]
%5 : float = const floats [2]
%7 : float[7] = if %4 dims [W, H, 1, 7, 1, 1] yields [scatter] {
  %6 : accumulation float[7] = if %c.2 dims [W, 1, 1, 7, 1, 1] yields [scatter] {
    yield %n.3, %5
  } {
    yield %n.3, %5
  }
  yield %6
} {
  yield %n.3, %5
}
)",
             {"%7"});
}

TEST_CASE("results of regions that nobody needs are dropped") {
  check(
      R"(%7 : float[W, H], %8 : float[7], %9 : int[5], %10 : float[W, H] = if %2 dims [W, H, 1, 7, 1, 1, 5, 1, 1] yields [element, scatter, scatter, element] {
  %5 : float[W, H] = sin %0
  yield %5, %3, %5, %3, %3, %0
} {
  %6 : float[W, H] = cos %0
  yield %6, %3, %6, %3, %3, %6
}
)",
      {"%9", "%10"}, R"(%5 : int[5], %6 : float[W, H] = if %c.2 dims [W, H, 1, 5, 1, 1] yields [scatter, element] {
  yield %n.3, %n.3, %x.0
} {
  %4 : float[W, H] = cos %x.0
  yield %n.3, %n.3, %4
}
)",
      {"%5", "%6"});
}

TEST_CASE("inside regions: shared with what stands before, not between branches") {
  check(R"(%4 : float[W, H] = sin %0
%9 : float[W, H] = if %2 dims [W, H, 1] yields [element] {
  %5 : float[W, H] = sin %0
  %6 : float[W, H] = cos %0
  %7 : float[W, H] = add %5, %6
  yield %7
} {
  %8 : float[W, H] = cos %0
  yield %8
}
)",
        {"%9", "%4"}, R"(%4 : float[W, H] = sin %x.0
%8 : float[W, H] = if %c.2 dims [W, H, 1] yields [element] {
  %5 : float[W, H] = cos %x.0
  %6 : float[W, H] = add %4, %5
  yield %6
} {
  %7 : float[W, H] = cos %x.0
  yield %7
}
)",
        {"%8", "%4"});
  // An op inside a region is no reason to keep one out of the way outside.
  check_kept(R"(%6 : float[W, H] = if %c.2 dims [W, H, 1] yields [element] {
  %4 : float[W, H] = sin %x.0
  yield %4
} {
  %5 : float[W, H] = exp %x.0
  yield %5
}
%7 : float[W, H] = sin %x.0
)",
             {"%6", "%7"});
}

TEST_CASE("inside regions a smaller extent is as good") {
  check(R"(%4 : float = const floats [0]
%9 : float[W, H] = if %2 dims [W, H, 1] yields [element] {
  %5 : float[W, H] = smul %4, %0
  %6 : float = convert %3 ints [3]
  %7 : float[W, H] = max %5, %6
  yield %7
} {
  yield %0
}
)",
        {"%9"}, R"(%4 : float = const floats [0]
%7 : float[W, H] = if %c.2 dims [W, H, 1] yields [element] {
  %5 : float = convert %n.3 ints [3]
  %6 : float = max %4, %5
  yield %6
} {
  yield %x.0
}
)",
        {"%7"});
}

TEST_CASE("equal ops with regions become one") {
  const std::string reduce = R"( = reduce %3, %3 ints [-1] dims [W, H, 1] yields [sum] (%I : int[W, H]) {
  %A : int[W, H] = gather %3, %I
  yield %A
}
)";
  const auto with = [&](const std::string& result, const std::string& i, const std::string& a) {
    std::string text = result + " : int[W, H]" + reduce;
    for (const auto& [from, to] : {std::pair{std::string("%I"), i}, {std::string("%A"), a}}) {
      for (size_t at = 0; (at = text.find(from, at)) != std::string::npos;) text.replace(at, from.size(), to);
    }
    return text;
  };
  const Graph graph = simplify(read(program(with("%6", "%4", "%5") + with("%9", "%7", "%8"), {"%6", "%9"})));
  CHECK(verify(graph).empty());
  CHECK(graph.op_count() == 6);
  CHECK(graph.steps[0].outputs[4].value == graph.steps[0].outputs[5].value);
}

TEST_CASE("what an element reads at its own place is itself") {
  check_becomes(R"(%4 : int[W, H] = coord ints [0] dims [W, H, 1]
%5 : int[W, H] = coord ints [1] dims [W, H, 1]
%6 : ivec2[W, H] = compose %4, %5 ints [2, 1]
%9 : float[W, H] = gather %0, %6
)",
                "%x.0");
  check_kept(R"(%4 : int[W, H] = coord ints [1] dims [W, H, 1]
%5 : int[W, H] = coord ints [0] dims [W, H, 1]
%6 : ivec2[W, H] = compose %4, %5 ints [2, 1]
%7 : float[W, H] = gather %x.0, %6
)",
             {"%7"});
  // Of a larger image it is a part.
  check_kept(R"(%4 : int[H, W] = coord ints [0] dims [H, W, 1]
%5 : int[H, W] = coord ints [1] dims [H, W, 1]
%6 : ivec2[H, W] = compose %4, %5 ints [2, 1]
%7 : float[H, W] = gather %x.0, %6
)",
             {"%7"});
}

TEST_CASE("the length of no vector is 0, of others the device's own") {
  check("%4 : vec3 = const floats [0, -0, 0]\n%5 : float = length %4\n", {"%5"}, "%4 : float = const floats [0]\n",
        {"%4"});
  check_kept("%4 : vec3 = const floats [0, 0, 2]\n%5 : float = length %4\n", {"%5"});
}

TEST_CASE("the first element of one element is all there is") {
  check_becomes("%4 : int = const floats [0]\n%9 : int = gather %3, %4\n", "%n.3");
  check_becomes("%4 : ivec3 = const floats [0, 0, 0]\n%9 : int = gather %3, %4\n", "%n.3");
  // Elsewhere is nothing, and an image has more.
  check_kept("%4 : ivec2 = const floats [0, 1]\n%5 : int = gather %n.3, %4\n", {"%5"});
  check_kept("%4 : ivec2 = const floats [0, 0]\n%5 : float = gather %x.0, %4\n", {"%5"});
}

TEST_CASE("grad targets are left alone") {
  // %5 and %6 are the same number, but the gradient asks for one of them.
  check_kept(R"(%4 : float = const floats [2]
%5 : float[W, H] = mul %x.0, %4
%6 : float[W, H] = mul %x.0, %4
%7 : float[W, H] = mul %5, %6
%8 : float[W, H] = grad %7, %7, %5
)",
             {"%8"});
  // x * 1 is no x, sums do not look into a target, and a constant may be one.
  check_kept(R"(%4 : float = const floats [1]
%5 : float[W, H] = mul %x.0, %4
%6 : float[W, H] = neg %5
%7 : float[W, H] = neg %6
%8 : float = const floats [1]
%9 : float[W, H] = mul %7, %8
%10 : float[W, H], %11 : float[W, H], %12 : float = grad %9, %x.0, %5, %6, %8
)",
             {"%10", "%11", "%12"});
  // Without the gradient nothing holds them.
  check(R"(%4 : float = const floats [1]
%5 : float[W, H] = mul %0, %4
%6 : float[W, H] = grad %5, %5, %5
)",
        {"%5"}, "", {"%x.0"});
}

TEST_CASE("leaf reads and coordinates are shared") {
  check(
      "%4 : float[W, H] = leaf text \"x\"\n%5 : int[W, H] = coord ints [0] dims [W, H, 1]\n%6 : int[W, H] = coord ints "
      "[0] dims [W, H, 1]\n"
      "%7 : int[W, H] = add %5, %6\n",
      {"%4", "%7"}, "%4 : int[W, H] = coord ints [0] dims [W, H, 1]\n%5 : int[W, H] = add %4, %4\n", {"%x.0", "%5"});
}

TEST_CASE("large graphs take time in proportion") {
  Builder b;
  const Extent extent{Dim::symbol("W"), Dim::symbol("H"), Dim::symbol("N")};
  b.graph().leaves.push_back({Leaf::Kind::Input, "x", kFloat, extent, {}, {}});
  std::vector<ValueId> values{dr::ops::emit(b, OpKind::Leaf, {}, {.text = "x"})};
  // Chains with equal parts, constants and zeros here and there.
  for (size_t i = 0; b.graph().op_count() < 20000; ++i) {
    const ValueId x = values[i / 2];
    const ValueId k = dr::ops::constant(b, kFloat, static_cast<double>(i % 5));
    values.push_back(i % 3 == 0   ? dr::ops::mul(b, x, k)
                     : i % 3 == 1 ? dr::ops::smul(b, k, x)
                                  : dr::ops::emit(b, OpKind::Sin, {x}));
    values.push_back(dr::ops::add(b, values.back(), x));
  }
  ValueId sum = values.back();
  for (size_t i = 0; i < values.size(); i += 2) sum = dr::ops::add(b, sum, values[i]);
  b.graph().steps.push_back({"s", {{"sum", sum}}, {}});
  const Graph graph = std::move(b).finish();
  const auto start = std::chrono::steady_clock::now();
  const Graph simpler = simplify(graph);
  const std::chrono::duration<double, std::milli> elapsed = std::chrono::steady_clock::now() - start;
  CHECK(verify(simpler).empty());
  WARN(graph.op_count() << " ops to " << simpler.op_count() << " in " << elapsed.count() << " ms");
  // Far above what it takes, far below what anything quadratic would.
  CHECK(elapsed.count() < 5000);
}
