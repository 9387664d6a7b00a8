// SPDX-License-Identifier: Apache-2.0
// The inverse of an index: for each target the sources that name it, in ascending order. Scatters become gathers by it.
// The host makes it whenever the integers that are the index are bound, as the tables of topology.h.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace dr::topology {

// What a leaf's `table` says: "rows:start:0,1,2" or "rows:item:0,1,2".
struct RowsName {
  bool items = false;
  std::vector<int> columns;  // of an element of the index, ascending
};
std::optional<RowsName> parse_rows(std::string_view table);

struct Rows {
  std::vector<int32_t> start;  // targets + 1: where each row begins in `item`, and the end of the last
  // Pairs for each source and column that name a target: source * columns + k, where columns[k] is the column, and the
  // target. Pairs of -1 up to sources * columns of them.
  std::vector<int32_t> item;
};

// `index` holds `components` integers a source. What is not in 0 .. targets - 1 names nothing.
Rows build_rows(std::span<const int32_t> index, int components, std::span<const int> columns, int64_t targets);

}  // namespace dr::topology
