// SPDX-License-Identifier: Apache-2.0
// Spans and positions: the edges of lines and of files.
#include "dsl/source/source.h"

#include "tests/catch.h"

using namespace dr::dsl;

TEST_CASE("positions count lines and columns from one") {
  SourceManager sources;
  const FileId file = sources.add("a.dr", "ab\n\ncd");
  const auto at = [&](uint32_t offset) {
    const Position position = sources.position(file, offset);
    return std::to_string(position.line) + ":" + std::to_string(position.column);
  };
  CHECK(at(0) == "1:1");
  CHECK(at(1) == "1:2");
  CHECK(at(2) == "1:3");  // the newline belongs to its line
  CHECK(at(3) == "2:1");
  CHECK(at(4) == "3:1");
  CHECK(at(6) == "3:3");  // the end of the file
  CHECK(sources.line(file, 1) == "ab");
  CHECK(sources.line(file, 2).empty());
  CHECK(sources.line(file, 3) == "cd");
}

TEST_CASE("a line has no newline, whatever the system calls one") {
  SourceManager sources;
  const FileId file = sources.add("a.dr", "ab\r\ncd\r\n");
  CHECK(sources.line(file, 1) == "ab");
  CHECK(sources.line(file, 2) == "cd");
  CHECK(sources.line(file, 3).empty());
}

TEST_CASE("an empty file has one empty line") {
  SourceManager sources;
  const FileId file = sources.add("a.dr", "");
  CHECK(sources.position(file, 0).line == 1);
  CHECK(sources.line(file, 1).empty());
}

TEST_CASE("texts stay where they are when others are added") {
  SourceManager sources;
  const FileId first = sources.add("a.dr", "short");
  const std::string_view text = sources.text(first);
  const std::string_view name = sources.name(first);
  for (int i = 0; i < 1000; ++i) sources.add("other.dr", "x");
  CHECK(sources.size() == 1001);
  CHECK(text.data() == sources.text(first).data());
  CHECK(text == "short");
  CHECK(name == "a.dr");
}

TEST_CASE("join covers both spans and ignores invalid ones") {
  const FileId file{0};
  const Span a{file, 2, 4};
  const Span b{file, 7, 9};
  CHECK(join(a, b) == Span{file, 2, 9});
  CHECK(join(b, a) == Span{file, 2, 9});
  CHECK(join(a, Span{}) == a);
  CHECK(join(Span{}, b) == b);
}
