// SPDX-License-Identifier: Apache-2.0
// Tokens: numbers beside dots, the encoding, documentation, and what is no token.
#include "dsl/syntax/lexer.h"

#include <cmath>
#include <limits>

#include "dsl/source/utf8.h"
#include "tests/catch.h"
#include "tests/unit/dsl/support.h"

using namespace dr::dsl;
using namespace dr::dsl::test;

namespace {

// All tokens, separated by spaces; an unreadable one is `?`, and the errors follow in brackets.
std::string tokens(std::string text) {
  SourceManager sources;
  DiagnosticList diagnostics;
  Lexer lexer(sources, sources.add("test.dr", std::move(text)), diagnostics);
  std::string out;
  for (Token token = lexer.next(); token.kind != TokenKind::End; token = lexer.next()) {
    if (!out.empty()) out += ' ';
    out += token.kind == TokenKind::Error ? "?" : std::string(lexer.text(token));
  }
  for (const Diagnostic& diagnostic : diagnostics.all()) {
    out += " [" + std::string(code_name(diagnostic.code)) + ' ' + std::to_string(diagnostic.span.begin) + '-' +
           std::to_string(diagnostic.span.end) + ": " + diagnostic.message;
    if (!diagnostic.help.empty()) out += " | " + diagnostic.help;
    out += ']';
  }
  return out;
}

std::string kinds(std::string text) {
  SourceManager sources;
  DiagnosticList diagnostics;
  Lexer lexer(sources, sources.add("test.dr", std::move(text)), diagnostics);
  std::string out;
  for (Token token = lexer.next(); token.kind != TokenKind::End; token = lexer.next()) {
    switch (token.kind) {
      case TokenKind::Name: out += 'n'; break;
      case TokenKind::Int: out += 'i'; break;
      case TokenKind::Float: out += 'f'; break;
      case TokenKind::String: out += 's'; break;
      default: out += token_text(token.kind).empty() ? "?" : std::string(token_text(token.kind)); break;
    }
    out += ' ';
  }
  return out;
}

}  // namespace

TEST_CASE("a dot beside a number is read by what follows it") {
  CHECK(tokens("2.px") == "2 . px");
  CHECK(tokens("2.5.px") == "2.5 . px");
  CHECK(tokens("0..K") == "0 .. K");
  CHECK(tokens("0..1") == "0 .. 1");
  CHECK(tokens("-1..2") == "- 1 .. 2");
  CHECK(tokens("t.0") == "t . 0");
  CHECK(tokens("a.0.1") == "a . 0 . 1");
  CHECK(tokens("a.0.1.2.x") == "a . 0 . 1 . 2 . x");
  CHECK(tokens("a.0..b.1") == "a . 0 .. b . 1");
  CHECK(tokens("f(1.5, 1e3)") == "f ( 1.5 , 1e3 )");
  CHECK(kinds("1.5 1e3 1E-3 1.5e+3 12 12u 0") == "f f f f i i i ");
  CHECK(kinds("a.0.1") == "n . i . i ");
}

TEST_CASE("malformed numbers") {
  CHECK(tokens("1.") == "? [E0007 0-2: expected a digit after '1.' | write '1.0']");
  CHECK(tokens("(1.)") == "( ? ) [E0007 1-3: expected a digit after '1.' | write '1.0']");
  CHECK(tokens("1e") == "? [E0007 0-2: expected the digits of an exponent after '1e']");
  CHECK(tokens("1.5e+;") == "? ; [E0007 0-5: expected the digits of an exponent after '1.5e+']");
  CHECK(tokens("2px") == "? [E0007 0-3: expected an operator after '2', found 'px' | write '2.px']");
  CHECK(tokens("1.5f") == "? [E0007 0-4: expected an operator after '1.5', found 'f' | write '1.5']");
  CHECK(tokens("0x1F") == "? [E0007 0-4: expected an operator after '0', found 'x1F']");
  CHECK(tokens("12u3") == "? [E0007 0-4: expected an operator after '12u', found '3']");
  CHECK(tokens("t.0e5") == "t . ? [E0007 2-5: expected an operator after '0', found 'e5']");
}

TEST_CASE("operators take as many characters as they can") {
  CHECK(kinds("+-*/%") == "+ - * / % ");
  CHECK(kinds("== = != ! < <= << > >= >>") == "== = != ! < <= << > >= >> ");
  CHECK(kinds("&&&|||^~") == "&& & || | ^ ~ ");
  CHECK(kinds("->-.....") == "-> - .. .. . ");
  CHECK(kinds("a<-b") == "n < - n ");
  CHECK(kinds("()[]{},;:") == "( ) [ ] { } , ; : ");
}

TEST_CASE("keywords are few; words with a meaning in some places are names") {
  CHECK(kinds("const let var fn if else for reduce raster return true false minimize") ==
        "const let var fn if else for reduce raster return true false minimize ");
  CHECK(kinds("edition import as param input state struct optimizer step update") == "n n n n n n n n n n ");
  CHECK(kinds("in over with output sum min max argmin") == "n n n n n n n n ");
  CHECK(kinds("Let lets _let let_ le iff") == "n n n n n n ");
}

TEST_CASE("the encoding is checked before anything is read") {
  CHECK(tokens("let x\xFF = 1;") == " [E0001 5-6: expected UTF-8 text, found the byte 0xff]");
  CHECK(tokens("// \xC3(") == " [E0001 3-4: expected UTF-8 text, found the byte 0xc3]");
  CHECK(tokens(std::string("ab\0c", 4)) == " [E0002 2-3: expected text, found a zero byte]");
  CHECK(tokens(std::string(100, 'a') + std::string(1, '\0')) == " [E0002 100-101: expected text, found a zero byte]");
  // The check works on eight bytes at a time: no place among them may matter.
  for (size_t at = 0; at < 24; ++at) {
    std::string text(24, ' ');
    text[at] = '\0';
    CHECK(tokens(text).find("E0002 " + std::to_string(at)) != std::string::npos);
    text[at] = '\x80';
    CHECK(tokens(text).find("E0001 " + std::to_string(at)) != std::string::npos);
    text[at] = '\x01';
    CHECK(tokens(text).find("E0004 " + std::to_string(at)) != std::string::npos);
  }
}

TEST_CASE("well-formed UTF-8 sequences and the others") {
  const auto length = [](std::string_view text) { return utf8_length(text, 0); };
  CHECK(length("a") == 1);
  CHECK(length("\xC2\x80") == 2);
  CHECK(length("\xDF\xBF") == 2);
  CHECK(length("\xE0\xA0\x80") == 3);
  CHECK(length("\xED\x9F\xBF") == 3);
  CHECK(length("\xF0\x90\x80\x80") == 4);
  CHECK(length("\xF4\x8F\xBF\xBF") == 4);
  CHECK(length("\x80") == 0);              // a continuation alone
  CHECK(length("\xC0\x80") == 0);          // overlong
  CHECK(length("\xC1\xBF") == 0);          // overlong
  CHECK(length("\xE0\x9F\xBF") == 0);      // overlong
  CHECK(length("\xF0\x8F\xBF\xBF") == 0);  // overlong
  CHECK(length("\xED\xA0\x80") == 0);      // a surrogate
  CHECK(length("\xF4\x90\x80\x80") == 0);  // past the last code point
  CHECK(length("\xF5\x80\x80\x80") == 0);
  CHECK(length("\xC3") == 0);
  CHECK(length("\xE2\x82") == 0);
  CHECK(length("\xF0\x9F\x98") == 0);
}

TEST_CASE("a byte order mark is skipped, in front only") {
  CHECK(tokens("\xEF\xBB\xBFlet") == "let");
  CHECK(tokens("let\xEF\xBB\xBF") == "let ? [E0004 3-6: expected code, found '\xEF\xBB\xBF' (U+FEFF)]");
}

TEST_CASE("stray characters") {
  CHECK(tokens("a ? b") == "a ? b [E0004 2-3: expected code, found '?' | write 'if condition { a } else { b }']");
  CHECK(tokens("$x") == "? x [E0004 0-1: expected code, found '$']");
  CHECK(tokens("\x07x") == "? x [E0004 0-1: expected code, found U+0007]");
  CHECK(tokens("x = \xC3\xA9") == "x = ? [E0004 4-6: expected code, found '\xC3\xA9' (U+00E9)]");
  // One word in another script is one error.
  CHECK(tokens("\xC3\xA9\xE2\x82\xAC x") == "? x [E0004 0-2: expected code, found '\xC3\xA9' (U+00E9)]");
}

TEST_CASE("comments") {
  CHECK(tokens("a // b\nc") == "a c");
  CHECK(tokens("a //") == "a");
  CHECK(tokens("// \xC3\xA9 ? @\nc") == "c");
  CHECK(tokens("a /* b */ c") ==
        "a c [E0004 2-4: expected code, found '/*' | write '//' in front of each line of a comment]");
  CHECK(tokens("a /*").starts_with("a [E0004"));
  CHECK(tokens("a\r\nb\r\n") == "a b");
}

TEST_CASE("strings") {
  CHECK(string_value(R"("a\n\t\"\\b")") == "a\n\t\"\\b");
  CHECK(string_value("\"\"").empty());
  CHECK(kinds("\"a // b\" c") == "s n ");
  CHECK(tokens("\"\xC3\xA9\"") == "\"\xC3\xA9\"");
  CHECK(tokens("\"abc\nd") == "? d [E0005 0-4: expected '\"' at the end of the string, found the end of the line]");
  CHECK(tokens("\"abc\r\nd").find("E0005 0-4") != std::string::npos);
  CHECK(tokens("\"abc") == "? [E0005 0-4: expected '\"' at the end of the string, found the end of the file]");
  CHECK(tokens("\"").find("E0005 0-1") != std::string::npos);
  CHECK(tokens("\"\\").find("E0005 0-2") != std::string::npos);
  CHECK(tokens("\"\\\"").find("E0005 0-3") != std::string::npos);
  CHECK(tokens("\"\\\n\"").find("E0005") != std::string::npos);
  CHECK(tokens(R"("a\q")") == R"(? [E0006 2-4: expected '\n', '\t', '\"' or '\\', found '\q'])");
  CHECK(tokens("\"\\\xC3\xA9\"").find("E0006 1-4") != std::string::npos);
}

TEST_CASE("documentation belongs to the token behind it") {
  SourceManager sources;
  DiagnosticList diagnostics;
  const FileId file = sources.add("test.dr",
                                  "/// one\r\n"
                                  "///two\n"
                                  "// not this\n"
                                  "///\n"
                                  "/// four\n"
                                  "//// nor this\n"
                                  "a b\n"
                                  "/// alone\n");
  Lexer lexer(sources, file, diagnostics);
  const Token a = lexer.next();
  const Token b = lexer.next();
  CHECK(lexer.doc(a) == "one\ntwo\n\nfour");
  CHECK(lexer.doc(b).empty());
  CHECK(a.first_on_line);
  CHECK_FALSE(b.first_on_line);
  const Token end = lexer.next();
  CHECK(end.kind == TokenKind::End);
  CHECK(lexer.next().kind == TokenKind::End);
}

TEST_CASE("values of numbers") {
  CHECK(int_value("0") == 0);
  CHECK(int_value("12u") == 12);
  CHECK(int_value("9223372036854775807") == std::numeric_limits<int64_t>::max());
  CHECK(int_value("9223372036854775808") == std::nullopt);
  CHECK(int_value(std::string(1000000, '9')) == std::nullopt);
  CHECK(int_value(std::string(1000000, '0') + "7") == 7);
  CHECK(float_value("1.5") == 1.5);
  CHECK(float_value("1e-3") == 1e-3);
  // The largest float, in the digits that people write for it, and the first number past it.
  CHECK(float_value("3.4028235e38").has_value());
  CHECK(float_value("3.4028236e38") == std::nullopt);
  CHECK(float_value("1e39") == std::nullopt);
  CHECK(float_value("1e999") == std::nullopt);
  CHECK(float_value("1e99999999999999999999") == std::nullopt);
  CHECK(float_value("0e99999999999999999999") == 0.0);
  CHECK(float_value("1e-999") == 0.0);
  CHECK(float_value("1e-99999999999999999999") == 0.0);
  CHECK(float_value("0." + std::string(1000, '0') + "1") == 0.0);
  CHECK(float_value("0." + std::string(1000, '0') + "1e1001") == 1.0);
  CHECK(float_value("1" + std::string(1000, '0') + ".0e-1000") == 1.0);
  CHECK(float_value("1" + std::string(1000, '0') + ".0") == std::nullopt);
  CHECK(float_value("1" + std::string(1000, '0') + ".0e-100") == std::nullopt);
}
