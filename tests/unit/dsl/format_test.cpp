// SPDX-License-Identifier: Apache-2.0
// The formatter on every program of the tree, as written and with its blanks and comments shuffled. What a layout looks
// like is shown by the golden files in tests/golden/fmt.
#include "dsl/format/format.h"

#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>
#include <vector>

#include "dsl/format/tokens.h"
#include "tests/catch.h"

using namespace dr::dsl;

namespace {

struct Formatted {
  FormatResult result;
  std::string messages;
};

Formatted format_text(const std::string& text) {
  SourceManager sources;
  DiagnosticList diagnostics;
  const FileId file = sources.add("test.dr", text);
  FormatResult result = format_source(sources, file, diagnostics);
  return {std::move(result), format(diagnostics, sources)};
}

// The text formatted; checks that a second pass changes nothing. Syntax tree and comments are compared by the
// formatter.
std::string formatted(const std::string& text) {
  const Formatted once = format_text(text);
  CAPTURE(text, once.result.text, once.messages);
  CHECK_FALSE(once.result.has_errors);
  CHECK(once.result.internal_error.empty());
  const Formatted twice = format_text(once.result.text);
  CHECK(twice.result.internal_error.empty());
  CHECK(twice.result.text == once.result.text);
  return once.result.text;
}

// All programs of the tree that parse.
std::vector<std::string> programs() {
  std::vector<std::string> texts;
  for (const char* folder : {"stdlib", "docs", "tests/golden"}) {
    for (const auto& entry : std::filesystem::recursive_directory_iterator(DR_SOURCE_DIR "/" + std::string(folder))) {
      if (entry.path().extension() != ".dr") continue;
      std::ifstream stream(entry.path(), std::ios::binary);
      std::string text(std::istreambuf_iterator<char>(stream), {});
      if (!format_text(text).result.has_errors) texts.push_back(std::move(text));
    }
  }
  return texts;
}

bool needs_neighbour(const LaidToken& token) {
  switch (token.kind) {
    case TokenKind::Name:
    case TokenKind::LeftParen:
    case TokenKind::RightParen:
    case TokenKind::LeftBracket:
    case TokenKind::RightBracket:
    case TokenKind::Comma:
    case TokenKind::Semicolon: return false;
    default: return true;
  }
}

// The tokens of `text` with other blanks and, here and there, comments between them.
std::string shuffled(const std::string& text, std::mt19937& random) {
  SourceManager sources;
  const FileId file = sources.add("test.dr", text);
  std::string out;
  const LaidToken* last = nullptr;
  const std::vector<LaidToken> tokens = laid_tokens(sources, file);
  for (const LaidToken& token : tokens) {
    // Between tokens such as those of `<-`, `2.px` and `>=` the lexer and the parser look at what stands side by side.
    const bool glued =
        last != nullptr && last->end == token.begin && (needs_neighbour(*last) || needs_neighbour(token));
    const auto choice = glued ? 0 : random() % 12;
    if (choice == 1) out += "  // " + std::to_string(random() % 100) + "\n";
    if (choice == 2) out += "\n// " + std::to_string(random() % 100) + "\n";
    if (choice == 3) out += "\n\n\n // own\n\n\n";
    if (choice == 4) out += "\n";
    if (choice == 5) out += " ///  \n";
    if (choice > 5) out += " ";
    if (!glued && choice == 0) out += "\t ";
    out += token.text;
    last = &token;
  }
  return out;
}

}  // namespace

TEST_CASE("formatting a program of the tree keeps its meaning, twice the same") {
  const std::vector<std::string> texts = programs();
  CHECK(texts.size() > 80);
  for (const std::string& text : texts) formatted(text);
}

TEST_CASE("formatting keeps comments wherever they stand") {
  std::mt19937 random(1);
  for (const std::string& text : programs()) {
    for (int round = 0; round < 3; ++round) formatted(shuffled(text, random));
  }
}

TEST_CASE("formatted lines are at most 120 columns wide where they can be") {
  const std::string text = formatted("edition 1;\nlet x = f(" + [] {
    std::string list = "a0";
    for (int i = 1; i < 100; ++i) list += ", g(b" + std::to_string(i) + " + c * d)";
    return list;
  }() + ");\n");
  for (size_t begin = 0; begin < text.size();) {
    const size_t end = text.find('\n', begin);
    CHECK(end - begin <= kFormatWidth);
    begin = end + 1;
  }
}

TEST_CASE("numbers, strings and blanks at the end of documentation stay as written") {
  CHECK(formatted("edition 1;\nlet x=1.50e+03+007;") == "edition 1;\nlet x = 1.50e+03 + 007;\n");
  CHECK(formatted("edition 1;\n/// a  \n/// b\nlet x=1;") == "edition 1;\n/// a  \n/// b\nlet x = 1;\n");
  CHECK(formatted("edition 1;\r\n// a \r\nlet x=2.px;\r\n") == "edition 1;\n// a\nlet x = 2.px;\n");
  CHECK(formatted("\xEF\xBB\xBF"
                  "edition 1;") == "edition 1;\n");
}

TEST_CASE("an update and a comparison with a negative number stay what they are") {
  CHECK(formatted("edition 1;\nstep s{x<-1.0;let y=a<- 1.0;}") ==
        "edition 1;\nstep s { x <- 1.0; let y = a < -1.0; }\n");
  CHECK(formatted("edition 1;\nstep s{minimize e over a with m(rate=0.5);(rate)<- x;((rig).b)<-y;(a)<(-b);}") ==
        "edition 1;\nstep s { minimize e over a with m(rate = 0.5); (rate) <- x; ((rig).b) <- y; (a) < (-b); }\n");
}

TEST_CASE("generic arguments that end in one token are told from operators") {
  CHECK(
      formatted("edition 1;\nfn f(a:array<array<int,2>,3>=b,c:array<(A<2>,B),(1+2)*3>)->array<T,K>{a>=b>>c}") ==
      "edition 1;\nfn f(a: array<array<int, 2>, 3> = b, c: array<(A<2>, B), (1 + 2) * 3>) -> array<T, K> { a >= b >> c "
      "}\n");
}

TEST_CASE("a comparison in a generic argument is none of its brackets") {
  CHECK(formatted("edition 1;\nfn f(a:T<(1<2)>,b:T<(x+y<z)>,c:T<m.A<B>,(m.A<B>,C)>) { a }") ==
        "edition 1;\nfn f(a: T<(1 < 2)>, b: T<(x + y < z)>, c: T<m.A<B>, (m.A<B>, C)>) { a }\n");
}

TEST_CASE("a gradient of one's own has a line above its function") {
  CHECK(formatted("edition 1;\nfn f(x) { x } @vjp ( f )\n\nfn g(x,d) { d }") ==
        "edition 1;\nfn f(x) { x }\n@vjp(f)\n\nfn g(x, d) { d }\n");
}

TEST_CASE("a file that does not parse is not formatted") {
  const Formatted broken = format_text("edition 1;\nlet x = ;\n");
  CHECK(broken.result.has_errors);
  CHECK(broken.result.text.empty());
  CHECK(broken.messages.find("E0102") != std::string::npos);
}
