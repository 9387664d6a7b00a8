// SPDX-License-Identifier: Apache-2.0
// The diagnostic list, the table of codes, and the formatter that every message of the front end
// goes through on its way to the terminal.
#include "dsl/diagnostic/diagnostic.h"

#include <algorithm>
#include <array>
#include <iterator>
#include <utility>

#include "dsl/source/place.h"
#include "dsl/source/utf8.h"

namespace dr::dsl {
namespace {

struct CodeRow {
  std::string_view name;
  std::string_view summary;
};

constexpr CodeRow kCodes[] = {
#define DR_DIAGNOSTIC(code, summary) {#code, summary},
#include "dsl/diagnostic/diagnostic_codes.def"
#undef DR_DIAGNOSTIC
};

// Code points of a source line that are printed. What is longer is cut around the caret.
constexpr size_t kMaxColumns = 100;
constexpr size_t kColumnsBeforeCaret = 40;

// One code point, or one byte where the text is not UTF-8.
size_t step_forward(std::string_view text, size_t at) { return at + std::max<size_t>(utf8_length(text, at), 1); }

size_t step_back(std::string_view text, size_t at) {
  for (size_t length = 2; length <= 4 && length <= at; ++length) {
    if (utf8_length(text, at - length) == length) return at - length;
  }
  return at - 1;
}

size_t count_columns(std::string_view text, size_t begin, size_t end) {
  size_t columns = 0;
  for (size_t at = begin; at < end; at = step_forward(text, at)) ++columns;
  return columns;
}

// A tab takes one column, or the caret would miss; a control character would reach the terminal.
void append_line_text(std::string& out, std::string_view text) {
  for (const char c : text) {
    if (c == '\t') {
      out += ' ';
    } else if (static_cast<uint8_t>(c) < 0x20 || c == 0x7F) {
      out += '?';
    } else {
      out += c;
    }
  }
}

void append_source_line(std::string& out, const SourceManager& sources, const Span& span) {
  const Position position = sources.position(span.file, span.begin);
  const std::string_view line = sources.line(span.file, position.line);
  // A span may start at the newline, and it may go on past this line: only the line's part is marked.
  const size_t begin = std::min<size_t>(position.column - 1, line.size());
  const size_t length = span.end > span.begin ? span.end - span.begin : 0;
  const size_t end = std::min<size_t>(begin + length, line.size());

  size_t from = 0;
  size_t to = line.size();
  if (line.size() > kMaxColumns) {
    from = begin;
    for (size_t i = 0; i < kColumnsBeforeCaret && from > 0; ++i) from = step_back(line, from);
    to = from;
    size_t columns = 0;
    for (; columns < kMaxColumns && to < line.size(); ++columns) to = step_forward(line, to);
    // Near the end of the line there is room for more of what stands before.
    for (; columns < kMaxColumns && from > 0; ++columns) from = step_back(line, from);
  }

  const std::string number = std::to_string(position.line);
  std::string text;
  if (from > 0) text += "...";
  append_line_text(text, line.substr(from, to - from));
  if (to < line.size()) text += "...";
  out += number + " |";
  if (!text.empty()) out += ' ' + text;
  out += '\n';
  const size_t indent = (from > 0 ? 3 : 0) + count_columns(line, from, begin);
  const size_t carets = std::max<size_t>(1, count_columns(line, begin, std::min(end, to)));
  out.append(number.size(), ' ');
  out += " | ";
  out.append(indent, ' ');
  out.append(carets, '^');
  out += '\n';
}

void append_location(std::string& out, const SourceManager& sources, const Span& span) {
  if (!span.valid()) return;
  const Position position = sources.position(span.file, span.begin);
  out += sources.name(span.file);
  out += ':' + std::to_string(position.line) + ':' + std::to_string(position.column) + ": ";
}

std::string to_lower(std::string_view text) {
  std::string lower(text);
  for (char& c : lower) {
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  }
  return lower;
}

// Insertions, deletions, substitutions and swaps of neighbours that turn one word into the other.
size_t edit_distance(std::string_view a, std::string_view b) {
  std::vector<size_t> before_last(b.size() + 1);
  std::vector<size_t> last(b.size() + 1);
  std::vector<size_t> row(b.size() + 1);
  for (size_t j = 0; j <= b.size(); ++j) last[j] = j;
  for (size_t i = 1; i <= a.size(); ++i) {
    row[0] = i;
    for (size_t j = 1; j <= b.size(); ++j) {
      const size_t changed = last[j - 1] + (a[i - 1] == b[j - 1] ? 0 : 1);
      row[j] = std::min({changed, last[j] + 1, row[j - 1] + 1});
      if (i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1]) {
        row[j] = std::min(row[j], before_last[j - 2] + 1);
      }
    }
    std::swap(before_last, last);
    std::swap(last, row);
  }
  return last[b.size()];
}

}  // namespace

std::string format_place(const SourceManager& sources, const Span& span) {
  std::string out;
  append_location(out, sources, span);
  return out;
}

std::string format_source_line(const SourceManager& sources, const Span& span) {
  std::string out;
  append_source_line(out, sources, span);
  return out;
}

std::string_view code_name(Code code) { return kCodes[static_cast<size_t>(code)].name; }

std::string_view code_summary(Code code) { return kCodes[static_cast<size_t>(code)].summary; }

Diagnostic& DiagnosticList::error(Code code, const Span& span, std::string message) {
  Diagnostic diagnostic{Severity::Error, code, span, std::move(message), {}, {}};
  // A function that is called twice says the same twice.
  const bool is_told = std::ranges::any_of(list_, [&](const Diagnostic& d) {
    return d.severity == Severity::Error && d.code == code && d.span == span && d.message == diagnostic.message;
  });
  // It counts all the same: the parser ends at a number of errors.
  if (error_count_++ < kMaxErrors && !is_told) return list_.emplace_back(std::move(diagnostic));
  return overflow_ = std::move(diagnostic);
}

Diagnostic& DiagnosticList::warning(Code code, const Span& span, std::string message) {
  return list_.emplace_back(Diagnostic{Severity::Warning, code, span, std::move(message), {}, {}});
}

std::string format(const DiagnosticList& list, const SourceManager& sources) {
  constexpr FileId root{0};  // programs come before what they import
  std::string out;
  for (const Diagnostic& diagnostic : list.all()) {
    append_location(out, sources, diagnostic.span);
    out += diagnostic.severity == Severity::Error ? "error[" : "warning[";
    out += code_name(diagnostic.code);
    out += "]: " + diagnostic.message + '\n';
    if (diagnostic.span.valid()) append_source_line(out, sources, diagnostic.span);
    // Of what is wrong in a module, the line of the program that led there is shown, too.
    bool is_shown = !diagnostic.span.valid() || diagnostic.span.file == root;
    for (const Note& note : diagnostic.notes) {
      append_location(out, sources, note.span);
      out += "note: " + note.message + '\n';
      if (is_shown || !(note.span.file == root)) continue;
      append_source_line(out, sources, note.span);
      is_shown = true;
    }
    if (!diagnostic.help.empty()) out += "help: " + diagnostic.help + '\n';
  }
  if (list.full()) {
    out += "stopped after " + std::to_string(DiagnosticList::kMaxErrors) + " errors\n";
  }
  return out;
}

std::optional<std::string> nearest_name(std::string_view name, const std::vector<std::string>& candidates) {
  constexpr size_t kMaxLength = 64;  // nobody misspells a longer word; keeps the cost bounded
  if (name.empty() || name.size() > kMaxLength) return std::nullopt;
  const std::string wanted = to_lower(name);
  const std::string* best = nullptr;
  size_t best_distance = 0;
  for (const std::string& candidate : candidates) {
    if (candidate.size() > kMaxLength || candidate == name) continue;
    // A third of the letters may be wrong: words of one or two letters have no misspellings.
    const size_t allowed = std::max(name.size(), candidate.size()) / 3;
    const size_t distance = edit_distance(wanted, to_lower(candidate));
    if (distance > allowed) continue;
    if (best == nullptr || distance < best_distance) {
      best = &candidate;
      best_distance = distance;
    }
  }
  if (best == nullptr) return std::nullopt;
  return *best;
}

}  // namespace dr::dsl
