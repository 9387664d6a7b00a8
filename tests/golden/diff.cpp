// SPDX-License-Identifier: Apache-2.0
// A unified diff by longest common subsequence of lines, after cutting the common head and tail.

#include "tests/golden/diff.h"

#include <algorithm>
#include <cstdint>
#include <vector>

namespace dr::golden {
namespace {

constexpr size_t kContext = 3;
constexpr size_t kMaxCells = size_t{1} << 24;  // of the table; larger texts are shown as replaced

struct Edit {
  char mark = ' ';  // ' ' both, '-' before only, '+' after only
  std::string_view line;
};

// Lines with their newline, so that a missing last one makes a difference.
std::vector<std::string_view> lines_with_ends(std::string_view text) {
  std::vector<std::string_view> lines;
  while (!text.empty()) {
    const size_t newline = text.find('\n');
    const size_t length = newline == std::string_view::npos ? text.size() : newline + 1;
    lines.push_back(text.substr(0, length));
    text.remove_prefix(length);
  }
  return lines;
}

std::vector<Edit> edits_between(const std::vector<std::string_view>& a, const std::vector<std::string_view>& b) {
  const size_t shorter = std::min(a.size(), b.size());
  size_t head = 0;
  while (head < shorter && a[head] == b[head]) ++head;
  size_t tail = 0;
  while (tail < shorter - head && a[a.size() - 1 - tail] == b[b.size() - 1 - tail]) ++tail;
  const size_t rows = a.size() - head - tail;
  const size_t columns = b.size() - head - tail;

  // common[i][j]: length of the longest common subsequence of a's and b's middles from i and j on.
  std::vector<uint32_t> common;
  const bool fits = rows == 0 || columns < kMaxCells / (rows + 1);
  if (fits) common.assign((rows + 1) * (columns + 1), 0);
  const auto cell = [&](size_t i, size_t j) -> uint32_t& { return common[i * (columns + 1) + j]; };
  for (size_t i = fits ? rows : 0; i-- > 0;) {
    for (size_t j = columns; j-- > 0;) {
      cell(i, j) = a[head + i] == b[head + j] ? cell(i + 1, j + 1) + 1 : std::max(cell(i + 1, j), cell(i, j + 1));
    }
  }

  std::vector<Edit> edits;
  for (size_t i = 0; i < head; ++i) edits.push_back({' ', a[i]});
  size_t i = 0;
  size_t j = 0;
  while (i < rows || j < columns) {
    if (fits && i < rows && j < columns && a[head + i] == b[head + j]) {
      edits.push_back({' ', a[head + i]});
      ++i, ++j;
    } else if (i < rows && (!fits || j == columns || cell(i + 1, j) >= cell(i, j + 1))) {
      edits.push_back({'-', a[head + i++]});
    } else {
      edits.push_back({'+', b[head + j++]});
    }
  }
  for (size_t k = a.size() - tail; k < a.size(); ++k) edits.push_back({' ', a[k]});
  return edits;
}

// "3,2": `count` lines after the first `skipped`; diff(1) names the line before an empty range.
std::string range(size_t skipped, size_t count) {
  return std::to_string(count == 0 ? skipped : skipped + 1) + "," + std::to_string(count);
}

}  // namespace

std::string unified_diff(std::string_view before, std::string_view after, const std::string& before_name,
                         const std::string& after_name) {
  if (before == after) return {};
  const std::vector<Edit> edits = edits_between(lines_with_ends(before), lines_with_ends(after));
  std::string text = "--- " + before_name + "\n+++ " + after_name + "\n";
  size_t before_line = 0;
  size_t after_line = 0;
  size_t done = 0;  // edits already counted into the two line numbers
  const auto is_change = [](const Edit& edit) { return edit.mark != ' '; };
  for (auto change = std::find_if(edits.begin(), edits.end(), is_change); change != edits.end();) {
    // A hunk goes on while the next change is so near that their contexts touch.
    const size_t first = static_cast<size_t>(change - edits.begin());
    size_t last = first;
    for (size_t k = first; k < edits.size() && k <= last + 2 * kContext; ++k) {
      if (is_change(edits[k])) last = k;
    }
    const size_t begin = std::max(done, first - std::min(first, kContext));
    const size_t end = std::min(edits.size(), last + kContext + 1);
    before_line += begin - done;
    after_line += begin - done;
    size_t before_count = 0;
    size_t after_count = 0;
    std::string body;
    for (size_t k = begin; k < end; ++k) {
      before_count += edits[k].mark != '+';
      after_count += edits[k].mark != '-';
      body += edits[k].mark;
      body += edits[k].line;
      if (!edits[k].line.ends_with('\n')) body += "\n\\ No newline at end of file\n";
    }
    text += "@@ -" + range(before_line, before_count) + " +" + range(after_line, after_count) + " @@\n" + body;
    before_line += before_count;
    after_line += after_count;
    done = end;
    change = std::find_if(edits.begin() + static_cast<std::ptrdiff_t>(end), edits.end(), is_change);
  }
  return text;
}

}  // namespace dr::golden
