// SPDX-License-Identifier: Apache-2.0
// Correct programs and their trees: one test a part of the grammar.
#include "dsl/syntax/parser.h"

#include "tests/catch.h"
#include "tests/unit/dsl/support.h"

using namespace dr::dsl;
using namespace dr::dsl::test;

namespace {

// The dump of a function's body, in one line, or the errors.
std::string body(std::string_view text) {
  const std::string out = items("fn f() { " + std::string(text) + " }");
  const std::string line = flat(out);
  const std::string_view head = "(fn f (params) ";
  return line.starts_with(head) ? line.substr(head.size(), line.size() - head.size() - 1) : out;
}

// The dump of a parameter's type.
std::string type(std::string_view text) {
  std::string out = items("input x : " + std::string(text) + ";");
  const std::string_view head = "(input x (: ";
  if (out.starts_with(head)) out = out.substr(head.size());
  if (out.ends_with("))\n")) out.resize(out.size() - 3);
  return out;
}

}  // namespace

TEST_CASE("a module: edition, documentation, imports") {
  const Parsed parsed(
      "/// About this file.\n"
      "edition 1;\n"
      "import std.camera;\n"
      "import std.optim as o;\n"
      "import local;\n"
      "/// The size.\n"
      "/// In pixels.\n"
      "const N = 3;\n");
  CHECK(parsed.messages().empty());
  CHECK(parsed.module.edition == 1);
  CHECK(parsed.module.edition_span.begin == 21);
  CHECK(dump(parsed.module) ==
        "(edition 1)\n"
        "(doc \"About this file.\")\n"
        "(import std.camera)\n"
        "(import std.optim as o)\n"
        "(import local)\n"
        "(const N (doc \"The size.\\nIn pixels.\") 3)\n");
}

TEST_CASE("constants, leaves and let") {
  CHECK(items("const N : int = 2 * K;") == "(const N (: int) (* 2 K))\n");
  CHECK(items("param p : vec3 = vec3(0.0); input q : vec3[V]; state s : float[1];") ==
        "(param p (: vec3) (= (call vec3 0.0)))\n"
        "(input q (: (type vec3 (extents V))))\n"
        "(state s (: (type float (extents 1))))\n");
  CHECK(items("let a = 1; let b : float = 2; let (c, _) = t; let (d) = 1;") ==
        "(let a 1)\n(let b (: float) 2)\n(let (tuple c _) t)\n(let d 1)\n");
}

TEST_CASE("functions and their parameters") {
  CHECK(items("fn f() { }") == "(fn f (params) (block))\n");
  CHECK(items("fn f<T, K>(a: array<T, K>, const k: int, x = 2.0, y,) -> T { y }") ==
        "(fn f\n"
        "  (generics T K)\n"
        "  (params (a (: (type array (of T K)))) (k const (: int)) (x (= 2.0)) y)\n"
        "  (-> T)\n"
        "  (block (value y)))\n");
  CHECK(items("/// Doc.\nfn f(g: fn) -> (vec3, float) { g }") ==
        "(fn f (doc \"Doc.\") (params (g (: fn))) (-> (tuple vec3 float)) (block (value g)))\n");
}

TEST_CASE("structs with fields, defaults and methods") {
  CHECK(items("struct S<T> { a: T; b: vec3 = vec3(1); /// m\n fn m(self, k) -> T { self.a } c: float; }") ==
        "(struct S\n"
        "  (generics T)\n"
        "  (fields (a (: T)) (b (: vec3) (= (call vec3 1))) (c (: float)))\n"
        "  (fn m (doc \"m\") (params self k) (-> T) (block (value (. self a)))))\n");
  CHECK(items("struct Empty { }") == "(struct Empty (fields))\n");
  // Methods may start in the first column.
  CHECK(items("struct S {\na: float;\nfn m(self) { self.a }\n}") ==
        "(struct S (fields (a (: float))) (fn m (params self) (block (value (. self a)))))\n");
}

TEST_CASE("optimizers") {
  CHECK(items("optimizer sgd(rate, m = 0.9) {\n"
              "state v = 0;\n"
              "state t : int;\n"
              "/// Moves x.\n"
              "update(x, g) { v <- m * v + g; x - rate * v } }") ==
        "(optimizer sgd\n"
        "  (params rate (m (= 0.9)))\n"
        "  (state v (: _) (= 0))\n"
        "  (state t (: int))\n"
        "  (fn update\n"
        "    (doc \"Moves x.\")\n"
        "    (params x g)\n"
        "    (block\n"
        "      (<- v (+ (* m v) g))\n"
        "      (value (- x (* rate v))))))\n");
}

TEST_CASE("steps: updates, outputs and minimize") {
  CHECK(
      items(
          "step fit { a <- a - 0.1 * g; minimize e over p, q with optim.adam(rate = 0.01); output e, f = e * 2.0; }") ==
      "(step fit\n"
      "  (block\n"
      "    (<- a (- a (* 0.1 g)))\n"
      "    (minimize e (over p q) (with (call (. optim adam) (named rate 0.01))))\n"
      "    (output e (f (* e 2.0)))))\n");
}

TEST_CASE("types") {
  CHECK(type("vec3") == "vec3");
  CHECK(type("camera.Pose") == "camera.Pose");
  CHECK(type("vec3[V]") == "(type vec3 (extents V))");
  CHECK(type("vec3[(W + 1) / 2, H, 1]") == "(type vec3 (extents (/ (+ W 1) 2) H 1))");
  CHECK(type("array<T, K>") == "(type array (of T K))");
  CHECK(type("array<vec3[W], 3>") == "(type array (of (type vec3 (extents W)) (value 3)))");
  CHECK(type("array<array<float, 2>, 3>") == "(type array (of (type array (of float (value 2))) (value 3)))");
  CHECK(type("array<float, array<a, array<b, c>>>") ==
        "(type array (of float (type array (of a (type array (of b c))))))");
  CHECK(type("array<float, 3>[W]") == "(type array (of float (value 3)) (extents W))");
  CHECK(type("(vec3, (float, fn), array<a, 1>)") == "(tuple vec3 (tuple float fn) (type array (of a (value 1))))");
}

TEST_CASE("a generic argument is a type or a value") {
  CHECK(type("a<K + 1>") == "(type a (of (value (+ K 1))))");
  CHECK(type("a<K * 2 - 1, m.N>") == "(type a (of (value (- (* K 2) 1)) m.N))");
  CHECK(type("a<m.N + 1>") == "(type a (of (value (+ (. m N) 1))))");
  CHECK(type("a<(K)>") == "(type a (of (value K)))");
  CHECK(type("a<(K + 1) * 2>") == "(type a (of (value (* (+ K 1) 2))))");
  CHECK(type("a<(1 + K)>") == "(type a (of (value (+ 1 K))))");
  CHECK(type("a<-1>") == "(type a (of (value (- 1))))");
  CHECK(type("a<f(x)>") == "(type a (of (value (call f x))))");
  CHECK(type("a<(A, B)>") == "(type a (of (tuple A B)))");
  CHECK(type("a<(A[1], b.B<3>)>") == "(type a (of (tuple (type A (extents 1)) (type b.B (of (value 3))))))");
  CHECK(type("a<fn>") == "(type a (of fn))");
}

TEST_CASE("the end of generic arguments may touch what follows") {
  CHECK(items("let x : array<float, 3>= y;") == "(let x (: (type array (of float (value 3)))) y)\n");
  CHECK(items("let x : a<b<c>>= y;") == "(let x (: (type a (of (type b (of c))))) y)\n");
}

TEST_CASE("precedence is GLSL's") {
  CHECK(expression("a || b && c | d ^ e & f == g < h << i + j * -k") ==
        "(|| a (&& b (| c (^ d (& e (== f (< g (<< h (+ i (* j (- k)))))))))))");
  CHECK(expression("-a * b + c << d > e != f & g ^ h | i && j || k") ==
        "(|| (&& (| (^ (& (!= (> (<< (+ (* (- a) b) c) d) e) f) g) h) i) j) k)");
  CHECK(expression("a - b - c") == "(- (- a b) c)");
  CHECK(expression("a / b * c % d") == "(% (* (/ a b) c) d)");
  CHECK(expression("a <= b == c >= d") == "(== (<= a b) (>= c d))");
  CHECK(expression("a >> b") == "(>> a b)");
  CHECK(expression("!a && ~b == - -c") == "(&& (! a) (== (~ b) (- (- c))))");
  CHECK(expression("-a.b") == "(- (. a b))");
  CHECK(expression("(a + b) * c") == "(* (+ a b) c)");
  // No generic arguments in expressions, and no update either.
  CHECK(expression("a < b > c") == "(> (< a b) c)");
  CHECK(expression("a<-1") == "(< a (- 1))");
}

TEST_CASE("literals") {
  CHECK(expression("12") == "12");
  CHECK(expression("12u") == "12u");
  CHECK(expression("1.5") == "1.5");
  CHECK(expression("1e3") == "1000.0");
  CHECK(expression("1e-30") == "1e-30");
  CHECK(expression("true") == "true");
  CHECK(expression("false") == "false");
  CHECK(expression("\"a\\\"b\\n\"") == "\"a\\\"b\\n\"");
  CHECK(expression("()") == "(tuple)");
  CHECK(expression("(1, 2.0)") == "(tuple 1 2.0)");
  CHECK(expression("[1, [2, 3]]") == "(array 1 (array 2 3))");
}

TEST_CASE("postfix operators") {
  CHECK(expression("a.b.c") == "(. (. a b) c)");
  CHECK(expression("a.0.1") == "(. (. a 0) 1)");
  CHECK(expression("2.px") == "(. 2 px)");
  CHECK(expression("x.at(p + 1).y") == "(. (call (. x at) (+ p 1)) y)");
  CHECK(expression("m[1][k + 1].x") == "(. (index (index m 1) (+ k 1)) x)");
  CHECK(expression("f()(1)[2]") == "(index (call (call f) 1) 2)");
  CHECK(expression("f(1, over = layers, rate = a == b)") == "(call f 1 (named over layers) (named rate (== a b)))");
}

TEST_CASE("words with a meaning in some places are ordinary names in the others") {
  CHECK(expression("step(a, b) + min(sum, max)") == "(+ (call step a b) (call min sum max))");
  CHECK(expression("mean(x, over = layers) + in.as.with") ==
        "(+ (call mean x (named over layers)) (. (. in as) with))");
  CHECK(body("let input = state; var output = param; output = update; output.x = 1; state(edition, import)") ==
        "(block (let input state) (var output param) (= output update) (= (. output x) 1) (value (call state edition "
        "import)))");
  CHECK(body("for in in in..over { } minimize over over over, with with with;") ==
        "(block (for in in over (block)) (minimize over (over over with) (with with)))");
  CHECK(body("step <- struct; output output;") == "(block (<- step struct) (output output))");
  CHECK(items("param param : param; step step { } struct struct { struct: struct; }") ==
        "(param param (: param))\n(step step (block))\n(struct struct (fields (struct (: struct))))\n");
  CHECK(expression("reduce(max, max in max..max, max = max) { max }") ==
        "(reduce max max max max (max max) (block (value max)))");
}

TEST_CASE("if is an expression, and its condition ends at the brace") {
  CHECK(expression("if a { 1 } else { 2 }") == "(if a (block (value 1)) (block (value 2)))");
  CHECK(expression("if a { 1 } else if b { 2 } else { 3 }") ==
        "(if a (block (value 1)) (block (value (if b (block (value 2)) (block (value 3))))))");
  CHECK(expression("const if a { 1 } else { 2 }") == "(const-if a (block (value 1)) (block (value 2)))");
  CHECK(expression("if f({ a }) { 1 } else { 2 }") ==
        "(if (call f (block (value a))) (block (value 1)) (block (value 2)))");
  CHECK(expression("if (if a { b } else { c }) { 1 } else { 2 }") ==
        "(if (if a (block (value b)) (block (value c))) (block (value 1)) (block (value 2)))");
  CHECK(expression("1 + if a { 1 } else { 2 } * 3") == "(+ 1 (* (if a (block (value 1)) (block (value 2))) 3))");
}

TEST_CASE("the last expression of a block is its value") {
  CHECK(body("a; b") == "(block (expr a) (value b))");
  CHECK(body("a; b;") == "(block (expr a) (expr b))");
  CHECK(body("{ a }") == "(block (value (block (value a))))");
  CHECK(body("if a { 1 } else { 2 }") == "(block (value (if a (block (value 1)) (block (value 2)))))");
  CHECK(body("if a { 1 } else { 2 } * b") == "(block (value (* (if a (block (value 1)) (block (value 2))) b)))");
  CHECK(body("return a;") == "(block (return a))");
  CHECK(body("a == b") == "(block (value (== a b)))");
}

TEST_CASE("const if is a statement where its branches have no values") {
  CHECK(body("const if a { x = 1; } y") == "(block (const-if a (block (= x 1))) (value y))");
  CHECK(body("const if a { x = 1; } else if b { x = 2; } else { x = 3; } -y") ==
        "(block (const-if a (block (= x 1)) (block (const-if b (block (= x 2)) (block (= x 3))))) (value (- y)))");
  CHECK(body("const if a { } else if b { }") == "(block (const-if a (block) (block (const-if b (block)))))");
  CHECK(body("const if a { 1 } else { 2 }") == "(block (value (const-if a (block (value 1)) (block (value 2)))))");
  CHECK(body("const if a { 1 } else if b { 2 } else { 3 } + c") ==
        "(block (value (+ (const-if a (block (value 1)) (block (value (const-if b (block (value 2)) (block (value "
        "3)))))) c)))");
}

TEST_CASE("statements") {
  CHECK(body("var x : float = 1; x = x + 1; v.y = 2; a[3].z[1] = 4;") ==
        "(block (var x (: float) 1) (= x (+ x 1)) (= (. v y) 2) (= (index (. (index a 3) z) 1) 4))");
  CHECK(body("for k in 0..K + 1 { a; }") == "(block (for k 0 (+ K 1) (block (expr a))))");
  // Only an arrow that touches is one, and only behind a name that starts a statement.
  CHECK(body("a <- b <-c;") == "(block (<- a (< b (- c))))");
  CHECK(body("a < -b") == "(block (value (< a (- b))))");
}

TEST_CASE("lambdas") {
  CHECK(expression("fn(x) { x }") == "(lambda (params x) (block (value x)))");
  CHECK(expression("array(K, fn(k: int, y = 1) -> vec3 { k })") ==
        "(call array K (lambda (params (k (: int)) (y (= 1))) (-> vec3) (block (value k))))");
  CHECK(expression("if fn() { a }() { 1 } else { 2 }") ==
        "(if (call (lambda (params) (block (value a)))) (block (value 1)) (block (value 2)))");
}

TEST_CASE("reduce") {
  CHECK(expression("reduce(argmin, i in 0..n - 1) { x.at(i) }") ==
        "(reduce argmin i 0 (- n 1) (block (value (call (. x at) i))))");
  CHECK(expression("reduce(sum, i in a..b, max = 64) { let y = i; y }") ==
        "(reduce sum i a b (max 64) (block (let y i) (value y)))");
}

TEST_CASE("raster") {
  CHECK(expression("raster(F, W, H, 1, nearest = 2) { setup(f) -> S { f } /// d\n keep(s, p) { true } }[0].face") ==
        "(. (index (raster (args F W H 1 (named nearest 2)) (fn setup (params f) (-> S) (block (value f))) (fn keep "
        "(doc \"d\") (params s p) (block (value true)))) 0) face)");
  CHECK(expression("raster(F) { }") == "(raster (args F))");
}

TEST_CASE("spans cover what was written") {
  const Parsed parsed("edition 1; let x : vec3[V] = (a + b).c * f(1);");
  REQUIRE(parsed.module.items.size() == 1);
  const auto text = [&](const Span& span) {
    return std::string(parsed.sources.text(span.file).substr(span.begin, span.end - span.begin));
  };
  const Stmt& let = *parsed.module.items[0].statement;
  CHECK(text(let.span) == "let x : vec3[V] = (a + b).c * f(1)");
  CHECK(text(let.pattern.span) == "x");
  CHECK(text(let.type->span) == "vec3[V]");
  CHECK(text(let.a->span) == "(a + b).c * f(1)");
  CHECK(text(let.a->a->span) == "(a + b).c");
  CHECK(text(let.a->a->a->span) == "(a + b)");
  CHECK(text(let.a->b->span) == "f(1)");
}

TEST_CASE("every if that gives a value has both branches, even after an error") {
  const Parsed parsed("edition 1; let x = if a { 1 };");
  CHECK(parsed.diagnostics.error_count() == 1);
  REQUIRE(parsed.module.items.size() == 1);
  CHECK(parsed.module.items[0].statement->a->inner->else_block.has_value());
}

TEST_CASE("Windows line ends and a byte order mark change nothing") {
  const std::string unix_text = "edition 1;\n/// Doc.\nlet a = 1;\n";
  std::string windows_text = "\xEF\xBB\xBF";
  for (const char c : unix_text) {
    if (c == '\n') windows_text += '\r';
    windows_text += c;
  }
  const Parsed unix_file(unix_text);
  const Parsed windows_file(windows_text);
  CHECK(windows_file.messages().empty());
  CHECK(dump(unix_file.module) == dump(windows_file.module));
}
