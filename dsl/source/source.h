// SPDX-License-Identifier: Apache-2.0
// Source texts and byte spans. A span is two 32-bit offsets into one source file; line and column
// are computed only when a diagnostic is printed.
#pragma once

#include <cstdint>
#include <deque>
#include <string>
#include <string_view>
#include <vector>

namespace dr::dsl {

// Index of a file in a SourceManager.
struct FileId {
  uint32_t index = UINT32_MAX;
  bool valid() const { return index != UINT32_MAX; }
  friend bool operator==(FileId, FileId) = default;
};

// Half-open byte range [begin, end) of one file. Synthetic code keeps the span of what it came from.
struct Span {
  FileId file;
  uint32_t begin = 0;
  uint32_t end = 0;
  bool valid() const { return file.valid(); }
  friend bool operator==(const Span&, const Span&) = default;
};

// The smallest span that covers both; they must be of one file.
Span join(const Span& a, const Span& b);

struct Position {
  uint32_t line = 1;    // 1-based
  uint32_t column = 1;  // 1-based, in bytes
};

// Owns the texts. Texts never move, so views into them stay valid while the manager lives.
class SourceManager {
 public:
  // `name` is what messages print (a path as the user gave it, or "<stdin>").
  FileId add(std::string name, std::string text);
  std::string_view name(FileId file) const;
  std::string_view text(FileId file) const;
  Position position(FileId file, uint32_t offset) const;
  std::string_view line(FileId file, uint32_t line_number) const;  // without the newline
  size_t size() const { return files_.size(); }

 private:
  struct File {
    std::string name;
    std::string text;
    std::vector<uint32_t> line_starts;
  };
  std::deque<File> files_;
};

}  // namespace dr::dsl
