// SPDX-License-Identifier: Apache-2.0
// Hostile texts: deep, long, cut off or damaged. None may overflow the stack, run for ever or take time
// that grows faster than the text.
#include <random>

#include "tests/catch.h"
#include "tests/sanitized.h"
#include "tests/unit/dsl/support.h"

using namespace dr::dsl;
using namespace dr::dsl::test;

namespace {

// Uses every construct of the grammar.
constexpr std::string_view kSample = R"(/// A sample.
edition 1;
import std.camera as cam;

/// A constant.
const N : int = 2 * 3;
param position : vec3[V] = vec3(0.0);
input face : ivec3[F];
state count : int;

struct Ray<T> { origin: T; direction: vec3 = vec3(0, 0, 1.5e-3); fn at(self, t) -> vec3 { self.origin + t } }

fn pick<T, K>(items: array<array<T, 2>, K + 1>, const k: int, g: fn = fn(x) { x }) -> (T, float) {
  var total = 0.0;
  for i in 0..K { total = total + items[i].x; total.y = 1u; }
  const if K > 2 { total = 1.0; } else if K > 1 { } else { total = -2.0; }
  let (a, b) = (items[0].0.1, !true || ~3 <-1 && "text\n" == name);
  let c = if a > b { { a } } else if const if N > 1 { true } else { false } { 1.0 } else { 2.px };
  return (a, reduce(sum, i in 0..N, max = 3) { c % 2 ^ 1 | 4 & 5 << 1 >> 2 });
}

optimizer sgd(rate = 0.1) { state m = 0; update(x, g) { m <- m + g; x - rate * m } }

let seen = raster(F, W, H, 1, nearest = 2) {
  setup(f) -> Ray<vec3> { Ray(origin = position.at(face.at(f).x), direction = [1, 2, 3][0]) }
  depth(s, p) -> float { 0.5 }
}[0];

step fit {
  minimize mean(seen.face, over = layers) over position, count with sgd(rate = 0.01);
  count <- count + 1;
  output seen, other = count * 2;
}
)";

void must_fail(const std::string& text, Code code) {
  const Parsed parsed(text);
  INFO(text.substr(0, 60));
  REQUIRE(parsed.diagnostics.all().size() == 1);
  CHECK(code_name(parsed.diagnostics.all()[0].code) == code_name(code));
  CHECK_FALSE(parsed.messages().empty());
}

std::string nested(std::string_view open, std::string_view middle, std::string_view close, size_t count) {
  return "edition 1; let x = " + repeat(open, count) + std::string(middle) + repeat(close, count) + ";";
}

}  // namespace

TEST_CASE("the sample is correct") {
  const Parsed parsed{std::string(kSample)};
  CHECK(parsed.messages().empty());
  CHECK(parsed.module.items.size() == 9);
}

TEST_CASE("deep nesting is an error") {
  constexpr size_t kDeep = 100000;
  must_fail(nested("(", "1", ")", kDeep), Code::E0106);
  must_fail(nested("[", "1", "]", kDeep), Code::E0106);
  must_fail(nested("{", "1", "}", kDeep), Code::E0106);
  must_fail(nested("-", "1", "", kDeep), Code::E0106);
  must_fail(nested("- ! ~", "1", "", kDeep), Code::E0106);
  must_fail(nested("f(", "1", ")", kDeep), Code::E0106);
  must_fail(nested("a[", "1", "]", kDeep), Code::E0106);
  must_fail(nested("1 + (", "1", ")", kDeep), Code::E0106);
  must_fail(nested("if a { 1 } else ", "{ 2 }", "", kDeep), Code::E0106);
  must_fail(nested("if ", "a", " { 1 } else { 2 }", kDeep), Code::E0106);
  must_fail(nested("if a { ", "1", " } else { 2 }", kDeep), Code::E0106);
  must_fail(nested("const if a { ", "1", " } else { 2 }", kDeep), Code::E0106);
  must_fail(nested("fn() { ", "1", " }", kDeep), Code::E0106);
  must_fail(nested("fn(x = ", "1", ") { 1 }", kDeep), Code::E0106);
  must_fail(nested("reduce(sum, i in 0..1) { ", "1", " }", kDeep), Code::E0106);
  must_fail(nested("reduce(sum, i in ", "1", "..1) { 1 }", kDeep), Code::E0106);
  must_fail(nested("raster(1) { tag(s, p) { ", "1", " } }", kDeep), Code::E0106);
  must_fail("edition 1; let x : " + repeat("array<", kDeep) + "a" + repeat(", 1>", kDeep) + " = 1;", Code::E0106);
  must_fail("edition 1; let x : " + repeat("(a, ", kDeep) + "a" + repeat(")", kDeep) + " = 1;", Code::E0106);
  must_fail("edition 1; let x : a<" + repeat("(", kDeep) + "a" + repeat(")", kDeep) + "> = 1;", Code::E0106);
  must_fail("edition 1; fn f() { " + repeat("for i in 0..1 { ", kDeep) + repeat("}", kDeep) + "}", Code::E0106);
  must_fail("edition 1; fn f() { const " + repeat("if a { } else ", kDeep) + "{ } }", Code::E0106);
}

TEST_CASE("nesting up to the limit is fine, one more is not") {
  // A level is a pair of brackets, a block, a prefix operator or an `else if`.
  CHECK(Parsed(nested("(", "1", ")", kMaxNesting)).messages().empty());
  must_fail(nested("(", "1", ")", kMaxNesting + 1), Code::E0106);
  CHECK(Parsed(nested("{", "1", "}", kMaxNesting)).messages().empty());
  must_fail(nested("{", "1", "}", kMaxNesting + 1), Code::E0106);
  CHECK(Parsed(nested("-", "1", "", kMaxNesting)).messages().empty());
  must_fail(nested("-", "1", "", kMaxNesting + 1), Code::E0106);
  CHECK(Parsed(nested("if a { ", "1", " } else { 2 }", kMaxNesting)).messages().empty());
  must_fail(nested("if a { ", "1", " } else { 2 }", kMaxNesting + 1), Code::E0106);
  // The last block of a chain is nested in all of its `else if`.
  CHECK(Parsed(nested("if a { 1 } else ", "{ 2 }", "", kMaxNesting)).messages().empty());
  must_fail(nested("if a { 1 } else ", "{ 2 }", "", kMaxNesting + 1), Code::E0106);
}

TEST_CASE("long chains of operations are an error") {
  constexpr size_t kLong = 1000000;
  must_fail("edition 1; let x = 1" + repeat("+1", kLong) + ";", Code::E0107);
  must_fail("edition 1; let x = a" + repeat(".b", kLong) + ";", Code::E0107);
  must_fail("edition 1; let x = a" + repeat("[0]", kLong) + ";", Code::E0107);
  must_fail("edition 1; let x = a" + repeat("()", kLong) + ";", Code::E0107);
  must_fail("edition 1; let x : b<a" + repeat(".b", kLong) + " + 1> = 1;", Code::E0107);
  must_fail("edition 1; fn f() { a" + repeat(".b", kLong) + " = 1; }", Code::E0107);
  // The number of operations, but a leaf: 999 additions are the limit.
  CHECK(Parsed("edition 1; let x = 1" + repeat("+1", kMaxHeight - 1) + ";").messages().empty());
  must_fail("edition 1; let x = 1" + repeat("+1", kMaxHeight) + ";", Code::E0107);
  // Chains inside of chains count together.
  std::string text = "1";
  for (int i = 0; i < 100; ++i) text = "(" + text + repeat("+1", 50) + ")";
  must_fail("edition 1; let x = " + text + ";", Code::E0107);
}

TEST_CASE("what is long without being deep is fine") {
  CHECK(Parsed("edition 1; let x = [1" + repeat(", -2.5 * a", 100000) + "];").messages().empty());
  CHECK(Parsed("edition 1; fn f() { " + repeat("a = a + 1; ", 100000) + " }").messages().empty());
  CHECK(Parsed("edition 1; let x = f(a" + repeat("+(b)", 900) + ", a" + repeat("+(b)", 900) + ");").messages().empty());
  CHECK(Parsed("edition 1;" + std::string(10000000, ' ') + "let x = 1; //" + std::string(1000000, '/'))
            .messages()
            .empty());
}

TEST_CASE("names have at most a hundred letters") {
  CHECK(Parsed("edition 1; let " + std::string(100, 'x') + " = 1;").messages().empty());
  must_fail("edition 1; let " + std::string(101, 'x') + " = 1;", Code::E0009);
  must_fail("edition 1; let " + std::string(1000000, 'x') + " = 1;", Code::E0009);
}

TEST_CASE("one line of ten megabytes") {
  const std::string names = repeat("name, ", 10000000 / 6);
  const std::string message = Parsed("edition 1; let x = [" + names + "1] 2;").messages();
  CHECK(message.find("expected ';' after the value of 'x', found '2'") != std::string::npos);
  CHECK(message.size() < 500);
  // Names in messages are cut, too.
  CHECK(Parsed("edition 1; let " + std::string(10000000, 'x') + " 1;").messages().size() < 500);
  CHECK(Parsed("edition 1; " + std::string(10000000, 'x')).messages().size() < 500);
  CHECK(Parsed("edition 1; let x = " + std::string(10000000, '1') + ";").messages().size() < 500);
  CHECK(Parsed("edition 1; let x = 1" + std::string(10000000, 'z') + ";").messages().size() < 500);
  CHECK(Parsed("edition 1; let x = \"" + std::string(10000000, 'z')).messages().size() < 500);
}

TEST_CASE("a file may end at every byte") {
  for (size_t length = 0; length <= kSample.size(); ++length) {
    const Parsed parsed{std::string(kSample.substr(0, length))};
    dump(parsed.module);
    parsed.messages();
    // What is cut behind an item is correct; what is cut inside of one is an error, and only one.
    INFO(parsed.messages());
    CHECK(parsed.diagnostics.error_count() <= 1);
  }
}

TEST_CASE("a file may lack or repeat every byte") {
  for (size_t at = 0; at < kSample.size(); ++at) {
    std::string text(kSample);
    text.erase(at, 1);
    dump(Parsed(text).module);
    text.insert(at, std::string(2, kSample[at]));
    dump(Parsed(text).module);
  }
}

TEST_CASE("random damage") {
  constexpr uint64_t kSeed = 20240229;
  std::mt19937_64 random(kSeed);
  const std::string_view pieces[] = {
      "(",   ")", "[",  "]",  "{",      "}",        ";",      ",",      "<",      ">",      ">>", ">=", "=",
      "<-",  ".", "..", "->", "if",     "else",     "const",  "let",    "fn",     "for",    "in", "x",  "0",
      "1.5", "@", "\"", "\n", "\nfn f", "\nstep s", "raster", "reduce", "output", "return", "-",  "+",  "///"};
  const auto below = [&](size_t count) { return static_cast<size_t>(random() % count); };
  for (int round = 0; round < dr::repeats(5000); ++round) {
    std::string text(kSample);
    const size_t edits = 1 + below(8);
    for (size_t edit = 0; edit < edits; ++edit) {
      const size_t at = below(text.size());
      const size_t length = below(12);
      const std::string_view piece = pieces[below(std::size(pieces))];
      switch (below(4)) {
        case 0: text.erase(at, length); break;
        case 1: text.insert(at, piece); break;
        case 2: text.replace(at, std::min(length, text.size() - at), piece); break;
        default: text[at] = static_cast<char>(below(256)); break;
      }
      if (text.empty()) text = " ";
    }
    const Parsed parsed(text);
    dump(parsed.module);
    parsed.messages();
  }
}

TEST_CASE("random tokens") {
  constexpr uint64_t kSeed = 7;
  std::mt19937_64 random(kSeed);
  const std::string_view pieces[] = {
      "(", ")",  "[",        "]",    "{",     "}",         ";",      ",",      "<",      ">",      "=",      "<-",
      ".", "..", "->",       ":",    "if",    "else",      "const",  "let",    "var",    "fn",     "for",    "in",
      "x", "0",  "1.5",      "true", "\"s\"", "\n",        "struct", "step",   "raster", "reduce", "output", "return",
      "-", "+",  "minimize", "over", "with",  "optimizer", "state",  "update", "import", "sum"};
  for (int round = 0; round < dr::repeats(5000); ++round) {
    std::string text = "edition 1;";
    const size_t count = random() % 60;
    for (size_t i = 0; i < count; ++i) {
      text += ' ';
      text += pieces[random() % std::size(pieces)];
    }
    const Parsed parsed(text);
    dump(parsed.module);
    parsed.messages();
  }
}
