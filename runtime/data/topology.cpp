// SPDX-License-Identifier: Apache-2.0
#include "runtime/data/topology.h"

#include "compiler/topology/rows.h"
#include "compiler/topology/topology.h"

namespace dr::runtime {

namespace {

// Tables of rows; those whose number of targets is not known yet are left out.
void add_rows(const bundle::BundleT& bundle, size_t index, const io::Array& data, const ir::SymbolValues& symbols,
              std::map<size_t, io::Array>& arrays) {
  for (size_t k = 0; k + 1 < bundle.leaves.size(); ++k) {
    // The starts of a table stand before its items.
    const bundle::LeafT &starts = *bundle.leaves[k], &items = *bundle.leaves[k + 1];
    if (starts.table_of != static_cast<int>(index) || items.table_of != starts.table_of) continue;
    const auto name = topology::parse_rows(starts.table), next = topology::parse_rows(items.table);
    if (!name || name->items || !next || !next->items || name->columns != next->columns) continue;
    if (name->columns.back() >= data.components) continue;
    const auto count = ir::Dim::parse(starts.extent->w)->evaluate(symbols);
    if (!count) continue;
    const topology::Rows rows = topology::build_rows(data.as<int32_t>(), data.components, name->columns, *count - 1);
    arrays.emplace(k, io::Array::from_ints(rows.start, 1));
    arrays.emplace(k + 1, io::Array::from_ints(rows.item, 2));
  }
}

}  // namespace

io::Result<std::map<size_t, io::Array>> topology_tables(const bundle::BundleT& bundle, size_t faces,
                                                        const io::Array& data, const ir::SymbolValues& symbols) {
  std::map<size_t, io::Array> arrays;
  int64_t vertices = -1;
  bool asked = false;
  add_rows(bundle, faces, data, symbols, arrays);
  for (const auto& leaf : bundle.leaves) {
    if (leaf->table_of != static_cast<int>(faces) || topology::parse_rows(leaf->table)) continue;
    asked = true;
    if (leaf->table != "vertex_start") continue;
    const auto count = ir::Dim::parse(leaf->extent->w)->evaluate(symbols);
    if (count) vertices = *count - 1;
  }
  if (!asked) return arrays;
  const auto built = topology::build(data.as<int32_t>(), vertices);
  if (const auto* error = std::get_if<std::string>(&built))
    return io::Error{"leaf '" + bundle.leaves[faces]->name + "': " + *error};
  const auto& tables = std::get<topology::Tables>(built);
  for (size_t k = 0; k < bundle.leaves.size(); ++k) {
    const bundle::LeafT& leaf = *bundle.leaves[k];
    const auto found = tables.data.find(leaf.table);
    if (leaf.table_of != static_cast<int>(faces) || found == tables.data.end()) continue;
    arrays.emplace(k, io::Array::from_ints(found->second, leaf.type->rows));
  }
  return arrays;
}

}  // namespace dr::runtime
