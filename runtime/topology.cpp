// SPDX-License-Identifier: Apache-2.0
#include "runtime/topology.h"

#include "compiler/topology/topology.h"

namespace dr::runtime {

io::Result<std::map<size_t, io::Array>> topology_tables(const bundle::BundleT& bundle, size_t faces,
                                                        const io::Array& data, const ir::SymbolValues& symbols) {
  std::map<size_t, io::Array> arrays;
  int64_t vertices = -1;
  bool asked = false;
  for (const auto& leaf : bundle.leaves) {
    if (leaf->table_of != static_cast<int>(faces)) continue;
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
