// SPDX-License-Identifier: Apache-2.0
// The text form: what it looks like, that it reads back (on random graphs too), and that no text breaks the parser.
#include <bit>
#include <cmath>
#include <limits>
#include <random>

#include "compiler/ir/parse.h"
#include "compiler/ir/print.h"
#include "tests/catch.h"
#include "tests/sanitized.h"

using namespace dr::ir;

namespace {

constexpr std::string_view kProgram = R"(leaf position : vec3[V] param = [0, 0.5, -1]
leaf photo : vec4[W, H, N] input
leaf "odd name" : float state
%0 : vec3[V] = leaf text "position"
%two.1 : float = const floats [2]
%2 : int = const floats [4]
%moved.3 : vec3[V] = mul %0, %two.1
%i.4 : int[(W + 1) / 2] = coord ints [0] dims [(W + 1) / 2, 1, 1]
%total.8 : float[(W + 1) / 2], %9 : vec3[V] = reduce %2, %2 ints [-1] dims [(W + 1) / 2, 1, 1, V, 1, 1] yields [sum, scatter] (%k.5 : int) {
  %6 : accumulation vec3[V] = reduce %2, %2 ints [8] dims [1, 1, 1, V, 1, 1] yields [scatter] {
    yield %i.4, %moved.3
  }
  %7 : float = neg %two.1
  yield %7, %6
}
step fit {
  output total %total.8
  output "a b" %two.1
  update position %9
}
step empty {
}
)";

std::string parse_error(std::string_view text) {
  const auto parsed = parse(text);
  const auto* error = std::get_if<ParseError>(&parsed);
  return error ? std::to_string(error->line) + ": " + error->message : "no error";
}

// Anything that the data structure can hold, sense or none.
class RandomGraph {
 public:
  explicit RandomGraph(uint64_t seed) : random_(seed) {}

  Graph make() {
    for (int i = pick(0, 4); i > 0; --i) {
      Leaf leaf{static_cast<Leaf::Kind>(pick(0, 2)), "leaf" + std::to_string(i) + name(), type(), extent(), {}, {}};
      for (int k = pick(0, 3); k > 0; --k) leaf.initial.push_back(number());
      b_.graph().leaves.push_back(leaf);
    }
    ops(pick(1, 12), 3);
    for (int i = pick(0, 3); i > 0; --i) {
      Step step{name(), {}, {}};
      for (int k = pick(0, 3); k > 0; --k) step.outputs.push_back({name(), visible_[index(visible_.size())]});
      for (int k = b_.graph().leaves.empty() ? 0 : pick(0, 2); k > 0; --k) {
        step.updates.push_back(
            {static_cast<uint32_t>(index(b_.graph().leaves.size())), visible_[index(visible_.size())]});
      }
      b_.graph().steps.push_back(step);
    }
    return std::move(b_).finish();
  }

 private:
  int pick(int low, int high) { return std::uniform_int_distribution<int>(low, high)(random_); }
  size_t index(size_t count) { return std::uniform_int_distribution<size_t>(0, count - 1)(random_); }

  std::string name() {
    static const std::string kNames[] = {
        "", "x", "soft.face", "4", "a.", "7.7", "weird \"name\"\n\\", "\x01\x7f\xc3\xa9", "text", "yield"};
    return kNames[index(std::size(kNames))];
  }
  double number() {
    const double special[] = {0.0, -0.0, 1.0, 0.1, 1e300, -5e-324, INFINITY, -INFINITY, std::nan(""), 16777217};
    return pick(0, 1) ? special[index(std::size(special))] : std::bit_cast<double>(random_());
  }
  Dim dim() {
    const Dim W = Dim::symbol("W"), V = Dim::symbol("V");
    const Dim dims[] = {1, 1, W, V, 7, (W + 1).divided_by(2), W * V - 3, Dim(std::numeric_limits<int64_t>::max()) + 1};
    return dims[index(std::size(dims))];
  }
  Extent extent() { return {dim(), dim(), dim()}; }
  Type type() {
    const Type types[] = {
        kFloat, kInt, kBool, kUint, vec(3), vec(2, Scalar::Int), {Scalar::Float, 4, 4}, {Scalar::Float, 3, 2}};
    return types[index(std::size(types))];
  }
  std::vector<ResultType> types(int most) {
    std::vector<ResultType> out;
    for (int i = pick(0, most); i > 0; --i) out.push_back({type(), extent(), pick(0, 5) == 0});
    return out;
  }
  std::vector<ValueId> uses(int most) {
    std::vector<ValueId> out;
    for (int i = visible_.empty() ? 0 : pick(0, most); i > 0; --i) out.push_back(visible_[index(visible_.size())]);
    return out;
  }
  void define(const std::vector<ValueId>& ids) {
    for (ValueId id : ids) {
      b_.set_name(id, name());
      visible_.push_back(id);
    }
  }

  void ops(int count, int depth) {
    const auto kinds = all_op_kinds();
    for (; count > 0 || visible_.empty(); --count) {
      Attrs attrs;
      for (int i = pick(0, 3) - 1; i > 0; --i) attrs.ints.push_back(static_cast<int64_t>(random_()));
      for (int i = pick(0, 3) - 1; i > 0; --i) attrs.floats.push_back(number());
      for (int i = pick(0, 3) - 1; i > 0; --i) attrs.dims.push_back(dim());
      for (int i = pick(0, 3) - 1; i > 0; --i) attrs.yields.push_back(static_cast<Yield>(pick(0, 5)));
      if (pick(0, 3) == 0) attrs.text = name();
      const std::vector<ValueId> operands = uses(4);  // an op's line comes before its regions
      std::vector<RegionId> regions;
      for (int i = depth == 0 ? 0 : pick(0, 4) - 2; i > 0; --i) {
        const RegionId region = b_.begin_region(types(2));
        define(b_.graph().region(region).params);
        ops(pick(0, 3), depth - 1);
        b_.end_region(uses(3));
        regions.push_back(region);
      }
      const OpId op = b_.add(kinds[index(kinds.size())], operands, types(3), attrs, regions);
      define(b_.graph().op(op).results);
    }
  }

  std::mt19937_64 random_;
  Builder b_;
  std::vector<ValueId> visible_;
};

}  // namespace

TEST_CASE("the text form reads back as it was written") {
  const auto parsed = parse(kProgram);
  INFO(parse_error(kProgram));
  REQUIRE(std::holds_alternative<Graph>(parsed));
  const Graph& graph = std::get<Graph>(parsed);
  CHECK(print(graph) == kProgram);

  CHECK(graph.leaves[0].initial == std::vector<double>{0, 0.5, -1});
  CHECK(graph.leaves[2].name == "odd name");
  CHECK(graph.leaves[2].kind == Leaf::Kind::State);
  CHECK(graph.value(ValueId{3}).name == "moved");
  CHECK(graph.value(ValueId{6}).accumulation);
  CHECK(graph.op(graph.value(ValueId{8}).op).attrs.yields == std::vector<Yield>{Yield::Sum, Yield::Scatter});
  CHECK(graph.value(ValueId{4}).extent.w == (Dim::symbol("W") + 1).divided_by(2));
  CHECK(graph.steps[0].updates[0].value == ValueId{9});
}

TEST_CASE("a printed op is its line") {
  const Graph graph = std::get<Graph>(parse(kProgram));
  const auto numbers = print_numbers(graph);
  CHECK(print_op(graph, graph.value(ValueId{6}).op, numbers) ==
        "%6 : accumulation vec3[V] = reduce %2, %2 ints [8] dims [1, 1, 1, V, 1, 1] yields [scatter]");
}

TEST_CASE("written by hand: comments, blank lines, other numbers, no names at uses") {
  const auto parsed = parse(R"(
    // Anything.
    %x.70 : float = const floats [1]   // one

    %30:float=neg %70
    step s {
      // nothing else
      output y %x.70
    }
)");
  REQUIRE(std::holds_alternative<Graph>(parsed));
  CHECK(print(std::get<Graph>(parsed)) ==
        "%x.0 : float = const floats [1]\n%1 : float = neg %x.0\nstep s {\n  output y %x.0\n}\n");
}

TEST_CASE("parse errors name the line, what was expected and what was found") {
  CHECK(parse_error("leaf x : vec9 param") == "1: expected a type, found 'vec9'");
  CHECK(parse_error("\n\nleaf x vec3 param") == "3: expected ':', found 'vec3'");
  CHECK(parse_error("leaf x : vec3 output") == "1: expected 'param', 'input' or 'state', found 'output'");
  CHECK(parse_error("leaf x : vec3[W +] input") == "1: expected an extent, found 'W +'");
  CHECK(parse_error("leaf x : vec3[1, 2, 3, 4] input") == "1: expected at most three extents, found more");
  CHECK(parse_error("%0 : float = frobnicate") == "1: expected an op's name, found 'frobnicate'");
  CHECK(parse_error("%0 : float = neg %1") == "1: value %1 is used before its definition");
  CHECK(parse_error("%0 : float = step_index\n%0 : float = step_index") == "2: value %0 is defined twice");
  CHECK(parse_error("%a.0 : int = step_index\n%1 : int = neg %b.0") == "2: value %0 is named 'a', found 'b'");
  CHECK(parse_error("%0 : float = const floats [1") == "1: expected ',' or ']', found the end of the text");
  CHECK(parse_error("%0 : float = const floats [1e999]") == "1: a number out of range: 1e999");
  CHECK(parse_error("%0 : int = dim ints [9223372036854775808]") == "1: an integer out of range: 9223372036854775808");
  CHECK(parse_error("%0 : int = step_index ints [1] ints [1]") == "1: ints given twice");
  CHECK(parse_error("%0 : int = step_index {\n  yield %0\n}") == "2: value %0 is used before its definition");
  CHECK(parse_error("%0 : int = step_index\nstep s {\n  update x %0\n}") == "3: expected a leaf's name, found 'x'");
  CHECK(parse_error("%0 : int = step_index\nstep s {\n  print %0\n}") ==
        "3: expected 'output', 'update' or '}', found 'print'");
  CHECK(parse_error("%x : int = step_index") == "1: expected a value's number, as in %12 or %name.12");
  CHECK(parse_error("hello") == "1: expected 'leaf', 'step', or an op's results, found 'hello'");
  CHECK(parse_error("leaf \"x : int param") ==
        "1: expected '\"' at the end of a quoted text, found the end of the line");
}

TEST_CASE("random graphs read back") {
  for (int seed = 0; seed < dr::repeats(2000); ++seed) {
    const std::string text = print(RandomGraph(static_cast<uint64_t>(seed)).make());
    CAPTURE(seed, text);
    const auto parsed = parse(text);
    INFO(parse_error(text));
    REQUIRE(std::holds_alternative<Graph>(parsed));
    REQUIRE(print(std::get<Graph>(parsed)) == text);
  }
}

TEST_CASE("a truncated or damaged text is an error or a graph, never a crash") {
  std::mt19937_64 random(1);
  const auto try_parse = [](const std::string& text) {
    const auto parsed = parse(text);
    if (const auto* graph = std::get_if<Graph>(&parsed)) {
      const std::string again = print(*graph);
      CAPTURE(text, again);
      const auto reparsed = parse(again);
      REQUIRE(std::holds_alternative<Graph>(reparsed));
      REQUIRE(print(std::get<Graph>(reparsed)) == again);
    }
  };
  for (size_t length = 0; length < kProgram.size(); ++length) try_parse(std::string(kProgram.substr(0, length)));
  for (int i = 0; i < dr::repeats(20000); ++i) {
    std::string text(kProgram);
    for (int k = 0; k < 3; ++k) {
      const size_t at = random() % text.size();
      switch (random() % 4) {
        case 0: text[at] = static_cast<char>(random()); break;
        case 1: text.erase(at, random() % 9); break;
        case 2: text.insert(at, text.substr(random() % text.size(), random() % 12)); break;
        default: text[at] = "%{}[]().,\"\n 0-/"[random() % 15]; break;
      }
    }
    try_parse(text);
  }
}

TEST_CASE("hostile texts are refused") {
  std::string nested, extents = "leaf x : float[";
  for (int i = 0; i < 100000; ++i) {
    nested += "= if {\n";
    extents += "(";
  }
  CHECK(parse_error(nested) == "201: regions nest deeper than 200");
  CHECK(parse_error(extents).starts_with("1: expected an extent"));
  CHECK(parse_error("%99999999999999999999 : int = step_index") ==
        "1: expected a value's number, as in %12 or %name.12");
  CHECK(parse_error(std::string(1000000, '%')) == "1: expected a value's number, as in %12 or %name.12");
  CHECK(parse_error(std::string("leaf x : float\0 param", 21)).starts_with("1: expected 'param'"));
}

TEST_CASE("an empty text is an empty graph") {
  for (const char* text : {"", "\n", "// nothing", "  \t\r\n"}) CHECK(print(std::get<Graph>(parse(text))).empty());
}

TEST_CASE("lines of ten megabytes") {
  const std::string name(10'000'000, 'x');
  std::string numbers = "%0 : float = const floats [1";
  for (int i = 0; i < 2'000'000; ++i) numbers += ", 2.5";
  CHECK(std::holds_alternative<Graph>(parse(numbers + "]")));
  CHECK(parse_error(numbers) == "1: expected ',' or ']', found the end of the text");
  CHECK(std::holds_alternative<Graph>(parse("leaf " + name + " : float param")));
  CHECK(std::holds_alternative<Graph>(parse("//" + name)));
  // Messages repeat only the beginning of a name.
  for (const std::string& text :
       {name, "leaf x : " + name, "leaf x : float[" + name + " +] param", "%0 : float = " + name,
        "%a.0 : int = step_index\n%1 : int = neg %" + name + ".0", "%0 : float = const floats [" + name,
        "%0 : int = step_index\nstep s {\n  update " + name + " %0\n}", "leaf \"" + name,
        "%0 : int = dim ints [" + std::string(10'000'000, '1')}) {
    const std::string message = parse_error(text);
    CHECK_FALSE(message.empty());
    CHECK(message.size() < 200);
  }
}

TEST_CASE("bytes that are no UTF-8 stand in quotes or are an error") {
  CHECK(parse_error("leaf \xff\xfe : float param").starts_with("1: expected a leaf's name"));
  const auto parsed = parse("leaf \"\xff\xc0\x80\" : float param\n");
  REQUIRE(std::holds_alternative<Graph>(parsed));
  const std::string text = print(std::get<Graph>(parsed));
  CHECK(print(std::get<Graph>(parse(text))) == text);
}
