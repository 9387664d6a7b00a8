// SPDX-License-Identifier: Apache-2.0
// Source texts: ownership, and the way from a byte offset to a line and a column. Line starts are
// found once, when a text is added, so that printing a message costs one binary search.
#include "dsl/source/source.h"

#include <algorithm>
#include <cassert>
#include <cstring>
#include <utility>

namespace dr::dsl {

Span join(const Span& a, const Span& b) {
  if (!a.valid()) return b;
  if (!b.valid()) return a;
  assert(a.file == b.file);
  return Span{a.file, std::min(a.begin, b.begin), std::max(a.end, b.end)};
}

FileId SourceManager::add(std::string name, std::string text) {
  File& file = files_.emplace_back(File{std::move(name), std::move(text), {0}});
  // Offsets have 32 bits. The lexer refuses texts that need more; here they only must not wrap.
  const char* const begin = file.text.data();
  const char* const end = begin + std::min<size_t>(file.text.size(), UINT32_MAX - 1);
  for (const char* at = begin; at < end; ++at) {
    at = static_cast<const char*>(std::memchr(at, '\n', static_cast<size_t>(end - at)));
    if (at == nullptr) break;
    file.line_starts.push_back(static_cast<uint32_t>(at - begin + 1));
  }
  return FileId{static_cast<uint32_t>(files_.size() - 1)};
}

std::string_view SourceManager::name(FileId file) const {
  assert(file.index < files_.size());
  return files_[file.index].name;
}

std::string_view SourceManager::text(FileId file) const {
  assert(file.index < files_.size());
  return files_[file.index].text;
}

Position SourceManager::position(FileId file, uint32_t offset) const {
  assert(file.index < files_.size());
  const std::vector<uint32_t>& starts = files_[file.index].line_starts;
  // The first start is 0, so there always is a line that starts at or before the offset.
  const auto line = std::upper_bound(starts.begin(), starts.end(), offset) - 1;
  return Position{static_cast<uint32_t>(line - starts.begin() + 1), offset - *line + 1};
}

std::string_view SourceManager::line(FileId file, uint32_t line_number) const {
  assert(file.index < files_.size());
  const File& source = files_[file.index];
  assert(line_number >= 1 && line_number <= source.line_starts.size());
  const size_t begin = source.line_starts[line_number - 1];
  const bool last = line_number == source.line_starts.size();
  const size_t end = last ? source.text.size() : source.line_starts[line_number] - 1;
  std::string_view line = std::string_view(source.text).substr(begin, end - begin);
  if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
  return line;
}

}  // namespace dr::dsl
