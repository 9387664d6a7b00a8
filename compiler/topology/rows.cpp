// SPDX-License-Identifier: Apache-2.0
#include "compiler/topology/rows.h"

namespace dr::topology {

std::optional<RowsName> parse_rows(std::string_view table) {
  RowsName out;
  constexpr std::string_view kStart = "rows:start:", kItem = "rows:item:";
  if (table.starts_with(kItem))
    out.items = true;
  else if (!table.starts_with(kStart))
    return std::nullopt;
  table.remove_prefix(out.items ? kItem.size() : kStart.size());
  for (size_t k = 0; k < table.size(); k += 2) {
    if (table[k] < '0' || table[k] > '3' || (k + 1 < table.size() && table[k + 1] != ',')) return std::nullopt;
    out.columns.push_back(table[k] - '0');
  }
  if (out.columns.empty()) return std::nullopt;
  return out;
}

Rows build_rows(std::span<const int32_t> index, int components, std::span<const int> columns, int64_t targets) {
  const auto width = static_cast<size_t>(components);
  const size_t sources = index.size() / width;
  Rows out;
  out.start.assign(static_cast<size_t>(targets) + 1, 0);
  const auto target_of = [&](size_t source, size_t k) {
    const int32_t target = index[source * width + static_cast<size_t>(columns[k])];
    return target >= 0 && target < targets ? target : -1;
  };
  for (size_t source = 0; source < sources; ++source)
    for (size_t k = 0; k < columns.size(); ++k)
      if (const int32_t target = target_of(source, k); target >= 0) ++out.start[static_cast<size_t>(target) + 1];
  for (size_t k = 1; k < out.start.size(); ++k) out.start[k] += out.start[k - 1];
  out.item.assign(2 * sources * columns.size(), -1);
  std::vector<int32_t> next(out.start.begin(), out.start.end() - 1);
  for (size_t source = 0; source < sources; ++source)
    for (size_t k = 0; k < columns.size(); ++k) {
      const int32_t target = target_of(source, k);
      if (target < 0) continue;
      const auto place = 2 * static_cast<size_t>(next[static_cast<size_t>(target)]++);
      out.item[place] = static_cast<int32_t>(source * columns.size() + k);
      out.item[place + 1] = target;
    }
  return out;
}

}  // namespace dr::topology
