// SPDX-License-Identifier: Apache-2.0
// .csv: a table of numbers, a line a row. What a spreadsheet or a measuring device writes, so a first line of words is
// a heading, and a field may stand in quotes. A number with a slip of the pen, or a mark for one that is missing, is no
// word: a row would be lost.
#include <algorithm>
#include <charconv>
#include <iterator>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "compiler/io/array/npy.h"
#include "compiler/io/file/failure.h"

namespace dr::io {
namespace {

std::string_view trimmed(std::string_view text) {
  const size_t begin = text.find_first_not_of(" \t\r");
  if (begin == std::string_view::npos) return {};
  return text.substr(begin, text.find_last_not_of(" \t\r") - begin + 1);
}

// std::from_chars takes no leading '+'.
bool read_number(std::string_view text, double& value) {
  if (text.starts_with('+')) text.remove_prefix(1);
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && end == text.data() + text.size() && !text.empty();
}

// Whether a field that is no number may stand in a heading; one without a word may, beside others that have one.
bool is_word(std::string_view field) {
  constexpr std::string_view kMissing[] = {"N/A", "n/a", "NA", "NULL", "Null", "null", "None", "none", "?"};
  constexpr std::string_view kMinus = "\u2212";
  const bool like_number = !field.empty() && std::string_view("0123456789+-.").find(field[0]) != std::string_view::npos;
  return !like_number && !field.starts_with(kMinus) && std::ranges::find(kMissing, field) == std::end(kMissing);
}

struct TableLine {
  std::vector<double> values;
  std::optional<std::string_view> wrong;  // the first field that is no number; of a line of words one that is no word
  bool is_heading = false;
};

TableLine read_row(std::string_view line) {
  TableLine row;
  std::optional<std::string_view> no_word;
  bool has_number = false, has_word = false;
  for (size_t begin = 0; begin <= line.size();) {
    const std::string_view rest = line.substr(begin);
    const size_t quote = rest.find_first_not_of(" \t");
    const bool quoted = quote != std::string_view::npos && rest[quote] == '"';
    const size_t behind = quoted ? std::min(rest.find('"', quote + 1), rest.size() - 1) + 1 : 0;
    const size_t end = std::min(line.find(',', begin + behind), line.size());
    std::string_view field = trimmed(line.substr(begin, end - begin));
    if (field.size() > 1 && field.starts_with('"') && field.ends_with('"'))
      field = trimmed(field.substr(1, field.size() - 2));
    double value = 0;
    if (read_number(field, value)) {
      has_number = true;
    } else {
      if (!row.wrong) row.wrong = field;
      if (!no_word && !is_word(field)) no_word = field;
      has_word = has_word || !field.empty();
    }
    row.values.push_back(value);
    begin = end + 1;
  }
  row.is_heading = has_word && !has_number && !no_word;
  if (!has_number && no_word) row.wrong = no_word;
  return row;
}

}  // namespace

Array parse_csv(std::string_view text, int expected_components) {
  std::vector<double> values;
  int64_t rows = 0, columns = 0;
  size_t line_number = 0;
  bool integers = true;
  if (text.starts_with("\xef\xbb\xbf")) text.remove_prefix(3);
  for (size_t begin = 0; begin < text.size();) {
    const size_t end = std::min(text.find('\n', begin), text.size());
    const std::string_view line = trimmed(text.substr(begin, end - begin));
    begin = end + 1;
    ++line_number;
    if (line.empty() || line.starts_with('#')) continue;
    const auto [row, wrong, is_heading] = read_row(line);
    if (rows == 0 && columns == 0 && is_heading) {
      columns = static_cast<int64_t>(row.size());
      continue;
    }
    if (wrong) fail("line ", line_number, ": expected a number, found ", in_quotes(*wrong));
    if (columns == 0) columns = static_cast<int64_t>(row.size());
    if (static_cast<int64_t>(row.size()) != columns)
      fail("line ", line_number, ": expected ", counted(columns, "number", "numbers"),
           " as in the line before it, found ", row.size());
    for (const double value : row) {
      integers = integers && value >= std::numeric_limits<int32_t>::min() &&
                 value <= std::numeric_limits<int32_t>::max() &&
                 value == static_cast<double>(static_cast<int32_t>(value));
    }
    values.insert(values.end(), row.begin(), row.end());
    ++rows;
  }
  if (rows == 0) fail("there are no numbers in it");
  // A column is a list, as a row is.
  const std::vector<int64_t> shape = columns == 1 ? std::vector<int64_t>{rows} : std::vector<int64_t>{rows, columns};
  const Extent extent = extent_of_shape(shape, expected_components);
  Array array = Array::from_doubles(values, extent.components, extent.width, extent.height, extent.layers);
  if (!integers) return array;
  auto whole = array.converted(ElementKind::Int32);
  if (!whole) fail(whole.error());
  return std::move(*whole);
}

Bytes encode_csv(const Array& array) {
  if (array.layers > 1) fail("a table has no layers, the array has ", array.layers, "; save it as .npy");
  if (array.components > 1 && array.height > 1)
    fail("a table holds a picture of one component, this has ", array.components, "; save it as .npy");
  const std::vector<double> values = array.to_doubles();
  const bool is_float = array.kind == ElementKind::Float32;
  const int64_t columns = array.height > 1 ? array.width : array.components;
  std::string text;
  for (size_t i = 0; i < values.size(); ++i) {
    char digits[32];
    // As short as reads back to the same number.
    const auto end = is_float ? std::to_chars(digits, digits + sizeof digits, static_cast<float>(values[i])).ptr
                              : std::to_chars(digits, digits + sizeof digits, values[i]).ptr;
    text.append(digits, end);
    text += static_cast<int64_t>(i + 1) % columns == 0 ? '\n' : ',';
  }
  return Bytes(text.begin(), text.end());
}

}  // namespace dr::io
