// SPDX-License-Identifier: Apache-2.0
// The one thing that a host computes for a program: tables of a mesh's topology, from its faces.
#include "compiler/topology/topology.h"

#include <algorithm>

#include "compiler/reference/evaluate.h"

namespace dr::reference {

std::optional<std::string> Session::make_tables() {
  for (size_t f = 0; f < leaves_.size(); ++f) {
    if (!stale_[f] || !leaves_[f]) continue;
    stale_[f] = false;
    const auto is_table = [&](const ir::Leaf& leaf) {
      return leaf.table_of == graph_.leaves[f].name && !leaf.table.empty();
    };
    if (std::ranges::none_of(graph_.leaves, is_table)) continue;

    const Image& image = *leaves_[f];
    const auto count = static_cast<size_t>(image.count());
    std::vector<int32_t> face(3 * count);
    for (size_t i = 0; i < count; ++i) {
      for (size_t c = 0; c < 3; ++c) face[3 * i + c] = static_cast<int32_t>(image.data[c * count + i]);
    }
    int64_t vertices = -1;
    for (const ir::Leaf& leaf : graph_.leaves) {
      if (is_table(leaf) && leaf.table == "vertex_start") vertices = leaf.extent.w.evaluate(symbols_).value_or(0) - 1;
    }
    const auto built = topology::build(face, vertices);
    if (const auto* error = std::get_if<std::string>(&built)) return "input '" + graph_.leaves[f].name + "': " + *error;
    const auto& tables = std::get<topology::Tables>(built);
    for (const ir::Leaf& leaf : graph_.leaves) {
      if (!is_table(leaf) || !tables.data.contains(leaf.table)) continue;
      const std::vector<int32_t>& data = tables.data.at(leaf.table);
      const size_t parts = static_cast<size_t>(leaf.type.components()), elements = data.size() / parts;
      Image table = zeros(leaf.type, static_cast<int64_t>(elements), 1, 1);
      for (size_t i = 0; i < elements; ++i) {
        for (size_t c = 0; c < parts; ++c) table.data[c * elements + i] = data[i * parts + c];
      }
      if (auto error = assign(*graph_.leaf_index(leaf.name), std::move(table))) return error;
    }
  }
  return std::nullopt;
}

}  // namespace dr::reference
