// SPDX-License-Identifier: Apache-2.0
// Wrong programs and what is said about them: the message, its place, and that reading goes on behind it.
#include <set>

#include "tests/catch.h"
#include "tests/unit/dsl/support.h"

using namespace dr::dsl;
using namespace dr::dsl::test;

TEST_CASE("the edition") {
  CHECK(errors("") ==
        "E0108 1:1 expected 'edition' at the start of the file, found the end of the file"
        " | write 'edition 1;' as the first line\n");
  CHECK(errors("let x = 1;") ==
        "E0108 1:1 expected 'edition' at the start of the file, found 'let' | write 'edition 1;' as the first line\n");
  CHECK(errors("edition 2;") == "E0109 1:9 expected edition 1, found edition '2', which is not supported\n");
  CHECK(errors("edition 99999999999999999999;").starts_with("E0109"));
  CHECK(errors("edition one;") == "E0101 1:9 expected the number of the edition after 'edition', found 'one'\n");
  CHECK(errors("edition 1\nlet x = 1;") == "E0101 1:10 expected ';' after the edition, found 'let'\n");
  CHECK(errors("editon 1; let x = 1;").starts_with("E0104 1:1"));
  CHECK(item_errors("let a = 1;\nedition 1;\nlet b = ;")
            .starts_with("E0110 3:1 expected 'edition' once, at the start of the file, found it again\nE0102 4:9"));
  CHECK(item_errors("let a = 1; import b;") ==
        "E0110 2:12 expected imports before all declarations, found one behind them\n");
}

TEST_CASE("a missing semicolon is marked where it is missing, and costs nothing else") {
  CHECK(item_errors("let x = 1\nlet y = 2\nlet z = ;") ==
        "E0101 2:10 expected ';' after the value of 'x', found 'let'\n"
        "E0101 3:10 expected ';' after the value of 'y', found 'let'\n"
        "E0102 4:9 expected an expression after '=', found ';'\n");
  CHECK(item_errors("let x = 1 let") == "E0101 2:11 expected ';' after the value of 'x', found 'let'\n");
  CHECK(body_errors("let x = 1") == "E0101 3:10 expected ';' after the value of 'x', found '}'\n");
  CHECK(body_errors("a <- 1\nb = 2\nf()\nreturn 1") ==
        "E0101 3:7 expected ';' after the next value of 'a', found 'b'\n"
        "E0101 4:6 expected ';' after the value of 'b', found 'f'\n"
        "E0101 5:4 expected ';' after the expression, found 'return'\n"
        "E0101 6:9 expected ';' after the value of 'return', found '}'\n");
}

TEST_CASE("misspelt words") {
  CHECK(item_errors("parm a : vec3;\nfm f() { }\nSTEP s { }\nbanana x;") ==
        "E0104 2:1 expected a declaration such as 'fn', 'let' or 'param', found 'parm' | did you mean 'param'?\n"
        "E0104 3:1 expected a declaration such as 'fn', 'let' or 'param', found 'fm'\n"
        "E0104 4:1 expected a declaration such as 'fn', 'let' or 'param', found 'STEP' | did you mean 'step'?\n"
        "E0104 5:1 expected a declaration such as 'fn', 'let' or 'param', found 'banana'\n");
  CHECK(
      body_errors("retrun a;\noutptu b;\nvec3 c = 1;") ==
      "E0105 3:1 expected a statement, found 'retrun' | did you mean 'return'?\n"
      "E0105 4:1 expected a statement, found 'outptu' | did you mean 'output'?\n"
      "E0122 5:1 expected a statement, found 'vec3', which is a word of other languages | write 'let' or 'var' and the "
      "name\n");
  CHECK(body_errors("minimize a ovr b with c;") ==
        "E0101 3:12 expected 'over' after the expression, found 'ovr' | did you mean 'over'?\n");
}

const std::string a_range = " | a range is 0..N, the numbers from 0 to N - 1; the elements of an image are x.at(k)";

TEST_CASE("every missing piece is named") {
  CHECK(item_errors("fn (x) { }") == "E0101 2:4 expected the name of a function after 'fn', found '('\n");
  CHECK(item_errors("fn f { }") == "E0101 2:6 expected '(' after 'f', found '{'\n");
  CHECK(item_errors("fn f(a b) { }") == "E0101 2:8 expected ')' after the parameters, found 'b'\n");
  CHECK(item_errors("fn f(a: ) { }") == "E0103 2:9 expected a type after ':', found ')'\n");
  CHECK(item_errors("fn f() 1") == "E0101 2:8 expected '{' after the parameters, found '1'\n");
  CHECK(item_errors("fn f<T() { }") == "E0101 2:7 expected '>' after the generic names, found '('\n");
  CHECK(item_errors("struct S { a float; b: int; 3 }") ==
        "E0101 2:14 expected ':' after the field 'a', found 'float'\n"
        "E0101 2:29 expected a field, a function or '}', found '3'\n");
  CHECK(item_errors("param p = 1;") == "E0101 2:9 expected ':' after 'p', found '='\n");
  CHECK(item_errors("param p : vec3 1;") == "E0101 2:16 expected ';' after the type of 'p', found '1'\n");
  CHECK(item_errors("const N;") == "E0101 2:8 expected '=' after 'N', found ';'\n");
  CHECK(item_errors("import 3;").starts_with("E0101"));
  CHECK(item_errors("import a.;") == "E0101 2:10 expected the name of a module after '.', found ';'\n");
  CHECK(item_errors("optimizer o() { update() { 1 } }") == "E0101 2:24 expected a parameter after '(', found ')'\n");
  CHECK(item_errors("let x = raster() { };") == "E0102 2:16 expected an expression after '(', found ')'\n");
  CHECK(item_errors("let (a b) = 1;") == "E0101 2:8 expected ')' after the names, found 'b'\n");
  CHECK(item_errors("let let = 1;") == "E0101 2:5 expected a name or '(' after 'let', found 'let'\n");
  CHECK(item_errors("let x = a.;") == "E0101 2:11 expected the name of a field after '.', found ';'\n");
  CHECK(item_errors("let x = a[;") == "E0102 2:11 expected an expression after '[', found ';'\n");
  CHECK(item_errors("let x = [];") == "E0102 2:10 expected an expression after '[', found ']'\n");
  CHECK(item_errors("let x = f(a, );") == "E0102 2:14 expected an expression after ',', found ')'\n");
  CHECK(item_errors("let x = reduce(sum, i 0..3) { i };") == "E0101 2:23 expected 'in' after 'i', found '0'\n");
  CHECK(item_errors("let x = reduce(sum, i in 0, 3) { i };") ==
        "E0101 2:27 expected '..' after the start of the range, found ','" + a_range + "\n");
  CHECK(item_errors("let x : a<b;") == "E0101 2:12 expected '>' after the generic arguments, found ';'\n");
  CHECK(item_errors("step s { output a, ; }") == "E0101 2:20 expected the name of an output after ',', found ';'\n");
  CHECK(body_errors("for k in 0..K a;") == "E0101 3:15 expected '{' after the range, found 'a'\n");
  CHECK(body_errors("return;") == "E0102 3:7 expected an expression after 'return', found ';'\n");
  CHECK(body_errors(")") == "E0105 3:1 expected a statement, found ')'\n");
}

TEST_CASE("an open bracket is pointed at when it is on another line") {
  const Parsed parsed("edition 1;\nlet x = f(1,\n  2;\nlet y = (3;");
  REQUIRE(parsed.diagnostics.all().size() == 2);
  REQUIRE(parsed.diagnostics.all()[0].notes.size() == 1);
  CHECK(parsed.diagnostics.all()[0].notes[0].message == "'(' opened here");
  CHECK(parsed.sources.position(parsed.module.file, parsed.diagnostics.all()[0].notes[0].span.begin).column == 10);
  CHECK(parsed.diagnostics.all()[1].notes.empty());
}

TEST_CASE("a lost brace does not swallow the next item") {
  CHECK(item_errors("fn f() {\n  for i in 0..1 {\n    a;\n\nfn g() { }\nlet x = ;") ==
        "E0101 6:1 expected '}' after the statements of the block, found 'fn'\n"
        "E0102 7:9 expected an expression after '=', found ';'\n");
  CHECK(item_errors("struct S {\n  a: float;\nstep s { }\nlet x = ;") ==
        "E0101 4:1 expected a field, a function or '}', found 'step'\n"
        "E0102 5:9 expected an expression after '=', found ';'\n");
  CHECK(item_errors("fn f() { } }\nlet x = ;") ==
        "E0104 2:12 expected a declaration such as 'fn', 'let' or 'param', found '}'\n"
        "E0102 3:9 expected an expression after '=', found ';'\n");
  CHECK(item_errors("fn f() {\n  let a = (1 +\n") ==
        "E0102 4:1 expected an expression after '+', found the end of the file\n");
  CHECK(item_errors("fn f() { a(").find("found the end of the file") != std::string::npos);
}

TEST_CASE("the parser goes on behind an error") {
  CHECK(body_errors("let a = 1 +;\nlet b = if c { 1 + } else { * };\nd = [1;\nlet e = f(fn(x) { ; x }, );\n") ==
        "E0102 3:12 expected an expression after '+', found ';'\n"
        "E0102 4:20 expected an expression after '+', found '}'\n"
        "E0105 4:29 expected a statement, found '*'\n"
        "E0101 5:7 expected ']' after the items of the array, found ';'\n"
        "E0105 6:19 expected a statement, found ';'\n"
        "E0102 6:26 expected an expression after ',', found ')'\n");
  CHECK(item_errors("fn f(a: ) { let z = 1; }\nfn g() { let = 1; }") ==
        "E0103 2:9 expected a type after ':', found ')'\n"
        "E0101 3:14 expected a name or '(' after 'let', found '='\n");
  CHECK(body_errors("for k in 0 K { a; }\nlet x = ;") ==
        "E0101 3:12 expected '..' after the start of the range, found 'K'" + a_range +
            "\n"
            "E0102 4:9 expected an expression after '=', found ';'\n");
}

TEST_CASE("if without a use or without else") {
  CHECK(body_errors("if a { 1 } else { 2 }\nb;") ==
        "E0112 3:1 the value of this 'if' is not used | assign its value with let\n");
  CHECK(body_errors("if a { 1 } else { 2 };\nb;") ==
        "E0112 3:1 the value of this 'if' is not used | assign its value with let\n");
  CHECK(body_errors("const if a { 1 } else { 2 }\nb;") ==
        "E0112 3:1 the value of this 'if' is not used | assign its value with let\n");
  CHECK(body_errors("if a { b = 1; }\nlet c = 2;").empty());
  CHECK(body_errors("if a { 1 }\nlet c = 2;")
            .starts_with("E0111 3:1 expected 'else' after an 'if' that gives a value, found 'let'"));
  CHECK(body_errors("let c = if a { 1 };") == "E0111 3:19 expected 'else' after the block of 'if', found ';'\n");
  CHECK(body_errors("let c = const if a { 1 };") == "E0111 3:25 expected 'else' after the block of 'if', found ';'\n");
  CHECK(body_errors("const if a { 1 }").starts_with("E0111 3:1"));
  CHECK(body_errors("if { 1 } else { 2 }") ==
        "E0102 3:4 expected an expression before the '{' of the body, found none\n");
  CHECK(body_errors("if {true} { 1 } else { 2 }\nlet x = 1;") ==
        "E0102 3:4 expected an expression before the '{' of the body, found none\n");
  CHECK(body_errors("for k in 0..{ a } { }").starts_with("E0102 3:13"));
  CHECK(body_errors("const K = 3;") == "E0101 3:7 expected 'if' after 'const', found 'K' | write 'let' in a block\n");
}

TEST_CASE("what cannot be assigned or updated") {
  CHECK(body_errors("a[0] <- 3;\nf() = 1;\na + b = 2;\n-a = 3;\nc[1].x = 4;") ==
        "E0113 3:1 expected the name of a param or state before '<-', found an expression\n"
        "E0113 4:1 expected a variable, a field or an item before '=', found another expression\n"
        "E0113 5:1 expected a variable, a field or an item before '=', found another expression\n"
        "E0113 6:1 expected a variable, a field or an item before '=', found another expression\n");
  CHECK(body_errors("a += 1;\nb.x *= 2;").empty());
  CHECK(body_errors("a++;\nb--;") ==
        "E0120 3:2 expected '=' or an operator, found '++' | write 'a += 1'\n"
        "E0120 4:2 expected '=' or an operator, found '--' | write 'b -= 1'\n");
}

TEST_CASE("raster and reduce know their words") {
  CHECK(
      item_errors("let x = raster(F) { setp(f) { 1 } keep(s, p) { 1 } keep(s, p) { 1 } 3 };") ==
      "E0114 2:21 expected 'setup', 'corner', 'depth', 'keep', 'tag' or 'cull', found 'setp' | did you mean 'setup'?\n"
      "E0115 2:52 expected one function 'keep', found a second\n"
      "E0101 2:69 expected a function of 'raster' or '}', found '3'\n");
  CHECK(item_errors("let x = reduce(product, i in 0..3) { i };\nlet y = reduce(summ, i in 0..3) { i };") ==
        "E0118 2:16 expected 'sum', 'min', 'max' or 'argmin', found 'product'\n"
        "E0118 3:16 expected 'sum', 'min', 'max' or 'argmin', found 'summ' | did you mean 'sum'?\n");
}

TEST_CASE("optimizers are complete and in order") {
  CHECK(item_errors("optimizer o() { state m = 0; }") ==
        "E0119 2:30 expected 'update' in the optimizer 'o', found '}'\n");
  CHECK(item_errors("optimizer o() { stat m = 0; }") ==
        "E0101 2:17 expected 'state', 'update' or '}', found 'stat' | did you mean 'state'?\n");
  CHECK(item_errors("optimizer o() { update(x) { x } state m = 0; update(x) { x } }") ==
        "E0101 2:33 expected each 'state' before 'update', found one behind it\n"
        "E0115 2:46 expected one 'update' in an optimizer, found a second\n");
}

TEST_CASE("types and tuples of the wrong size") {
  CHECK(item_errors("let a : vec3[] = 1;\nlet b : vec3[1, 2, 3, 4] = 1;\nlet c : (vec3) = 1;\nlet d = (1,);\nlet e : "
                    "a<(b[1])> = 1;") ==
        "E0116 2:13 expected one to three extents, found none\n"
        "E0116 3:23 expected at most three extents, found a fourth\n"
        "E0117 4:9 expected two or more types in a tuple, found one\n"
        "E0117 5:9 expected two or more elements in a tuple, found one\n"
        "E0117 6:12 expected two or more types in a tuple, found one\n");
}

TEST_CASE("return ends a function and nothing else") {
  CHECK(body_errors("return 1;\nlet a = 2;") ==
        "E0121 3:1 expected 'return' only as the last statement of a function, found it before other statements\n");
  CHECK(body_errors("return 1;\n2") ==
        "E0121 3:1 expected 'return' only as the last statement of a function, found it before other statements\n");
  CHECK(body_errors("let a = if b { return 1; } else { 2 };\n3") ==
        "E0121 3:16 expected 'return' only as the last statement of a function, found it in another block\n");
  CHECK(item_errors("step s { return 1; }").starts_with("E0121"));
  CHECK(item_errors("let f = fn(x) { return x; };").empty());
}

TEST_CASE("an unreadable character is one error") {
  CHECK(body_errors("let w = a ? 1 : 2;\nlet x = 1. + 2;\nlet y = \"abc;\nlet z = \xC3\xA9;\nlet ok = 1;") ==
        "E0004 3:11 expected code, found '?' | write 'if condition { a } else { b }'\n"
        "E0007 4:9 expected a digit after '1.' | write '1.0'\n"
        "E0005 5:9 expected '\"' at the end of the string, found the end of the line\n"
        "E0004 6:9 expected code, found '\xC3\xA9' (U+00E9)\n");
  CHECK(errors("edition 1;\nlet x\xFF = 1;") == "E0001 2:6 expected UTF-8 text, found the byte 0xff\n");
}

TEST_CASE("numbers that are too large") {
  CHECK(item_errors("let a = 9223372036854775808;\nlet b = 1e39;\nlet c = t.1234567890;\nlet d = .5;") ==
        "E0008 2:9 expected an integer of at most 63 bits, found '9223372036854775808'\n"
        "E0008 3:9 expected a number in the range of float, found '1e39'\n"
        "E0008 4:11 expected a tuple index of at most 9 digits, found '1234567890'\n"
        "E0102 5:9 expected an expression after '=', found '.' | write a digit before the '.'\n");
}

TEST_CASE("a function with a name inside a block") {
  CHECK(body_errors("  fn g(x) { x }\nlet y = ;") ==
        "E0105 3:3 expected a statement, found a function with a name"
        " | declare the function outside, or write 'let g = fn(...) { ... };'\n"
        "E0102 4:9 expected an expression after '=', found ';'\n");
}

TEST_CASE("reading stops after the limit") {
  const Parsed parsed("edition 1;\n" + repeat("let x = ;\n", 1000));
  CHECK(parsed.diagnostics.error_count() == DiagnosticList::kMaxErrors);
  const Parsed strays("edition 1;\n" + repeat("$ ", 1000));
  CHECK(strays.diagnostics.error_count() == DiagnosticList::kMaxErrors);
}

TEST_CASE("an expression ends with the text") {
  CHECK(expression("1 + 2") == "(+ 1 2)");
  CHECK(expression("vec3(1, -2, 3.5)") == "(call vec3 1 (- 2) 3.5)");
  CHECK(expression("1 2").starts_with("test.dr:1:3: error[E0101]: expected the end of the expression, found '2'\n"));
  CHECK(expression("").starts_with("test.dr:1:1: error[E0102]: expected an expression, found the end of the file\n"));
  CHECK(expression("1;").starts_with("test.dr:1:2: error[E0101]"));
}

TEST_CASE("messages are lower case, short and without a full stop; every code has a cause") {
  const std::string programs[] = {
      "edition 1; let \xFF",
      std::string("edition 1;\0", 11),
      "edition 1; $",
      "edition 1; \"abc",
      "edition 1; let x = \"\\q\";",
      "edition 1; let x = 1.;",
      "edition 1; let x = 1e99;",
      "edition 1; let " + repeat("x", 102) + " = 1;",
      "edition 1; let x 1;",
      "edition 1; let x = ;",
      "edition 1; let x : = 1;",
      "edition 1; banana",
      "edition 1; fn f() { ) }",
      "edition 1; let x = " + repeat("(", 1000),
      "edition 1; let x = a" + repeat("+a", 2000),
      "let x = 1;",
      "edition 7;",
      "edition 1; edition 1;",
      "edition 1; let x = if a { 1 };",
      "edition 1; fn f() { if a { 1 } else { 2 } b; }",
      "edition 1; fn f() { 1 = 2; }",
      "edition 1; let x = raster(1) { banana(f) { 1 } };",
      "edition 1; let x = raster(1) { keep(f) { 1 } keep(f) { 1 } };",
      "edition 1; let x : vec3[] = 1;",
      "edition 1; let x = (1,);",
      "edition 1; let x = reduce(banana, i in 0..1) { i };",
      "edition 1; optimizer o() { }",
      "edition 1; fn f() { a++; }",
      "edition 1; fn f() { while a { b = 1; } }",
      "edition 1; fn f() { return 1; 2 }",
      "edition 1; private input x : float;",
  };
  std::set<std::string_view> seen;
  for (const std::string& program : programs) {
    const Parsed parsed(program);
    CHECK(parsed.diagnostics.has_errors());
    for (const Diagnostic& diagnostic : parsed.diagnostics.all()) {
      INFO(diagnostic.message);
      seen.insert(code_name(diagnostic.code));
      CHECK((diagnostic.message[0] == '\'' || (diagnostic.message[0] >= 'a' && diagnostic.message[0] <= 'z')));
      CHECK_FALSE(diagnostic.message.ends_with('.'));
      CHECK(diagnostic.message.size() < 160);
      CHECK(diagnostic.message.find('\n') == std::string::npos);
    }
  }
  const std::string_view codes[] = {
#define DR_DIAGNOSTIC(code, summary) #code,
#include "dsl/diagnostic/diagnostic_codes.def"
#undef DR_DIAGNOSTIC
  };
  for (const std::string_view code : codes) {
    // A file of four gigabytes is no unit test; later groups have tests of their own.
    if (code == "E0003" || code >= "E0200") continue;
    INFO(code);
    CHECK(seen.contains(code));
  }
}
