// SPDX-License-Identifier: Apache-2.0
// Wording of messages, and the overflow-safe size of an array.

#include "compiler/io/file/failure.h"

#include <algorithm>
#include <charconv>
#include <numeric>
#include <vector>

namespace dr::io {
namespace {

template <class T>
void append_number(std::string& out, T number) {
  char buffer[32];
  const auto end = std::to_chars(buffer, buffer + sizeof buffer, number);
  out.append(buffer, end.ptr);
}

// Insertions, deletions, replacements and swaps of neighbours.
size_t edit_distance(std::string_view a, std::string_view b) {
  std::vector<size_t> before(b.size() + 1);
  std::vector<size_t> above(b.size() + 1);
  std::vector<size_t> row(b.size() + 1);
  std::iota(row.begin(), row.end(), size_t{0});
  for (size_t i = 1; i <= a.size(); ++i) {
    before.swap(above);
    above.swap(row);
    row[0] = i;
    for (size_t j = 1; j <= b.size(); ++j) {
      row[j] = std::min({above[j] + 1, row[j - 1] + 1, above[j - 1] + (a[i - 1] == b[j - 1] ? 0 : 1)});
      if (i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1]) row[j] = std::min(row[j], before[j - 2] + 1);
    }
  }
  return row.back();
}

}  // namespace

void append(std::string& out, std::string_view text) { out += text; }
void append(std::string& out, char character) { out += character; }
void append(std::string& out, double number) { append_number(out, number); }
void append_signed(std::string& out, int64_t number) { append_number(out, number); }
void append_unsigned(std::string& out, uint64_t number) { append_number(out, number); }

std::string in_quotes(std::string_view text, size_t longest) {
  constexpr std::string_view kHex = "0123456789abcdef";
  std::string out = "'";
  for (const char c : text.substr(0, longest)) {
    const auto byte = static_cast<unsigned char>(c);
    if (byte >= 0x20 && byte != 0x7f) {
      out += c;
    } else {
      out += "\\x";
      out += kHex[byte >> 4];
      out += kHex[byte & 15];
    }
  }
  return out + (text.size() > longest ? "...'" : "'");
}

std::string path_in_quotes(std::string_view path) { return in_quotes(path, path.size()); }

std::string counted(int64_t count, std::string_view one, std::string_view many) {
  return cat(count, " ", count == 1 ? one : many);
}

std::string_view nearest(std::string_view word, std::span<const std::string_view> candidates) {
  if (word.empty() || word.size() > 64) return {};
  // One slip in three letters is a misspelling; more is another word.
  size_t best_distance = (word.size() + 1) / 3 + 1;
  std::string_view best;
  for (const std::string_view candidate : candidates) {
    const size_t distance = edit_distance(word, candidate);
    if (distance < best_distance) {
      best_distance = distance;
      best = candidate;
    }
  }
  return best;
}

std::string did_you_mean(std::string_view word, std::span<const std::string_view> candidates) {
  const std::string_view best = nearest(word, candidates);
  return best.empty() ? std::string() : cat(" (did you mean '", best, "'?)");
}

}  // namespace dr::io
