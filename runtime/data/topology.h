// SPDX-License-Identifier: Apache-2.0
// Tables that a program asks of its meshes, from the faces that were bound.
#pragma once

#include <map>
#include <string>

#include "compiler/backend/bundle/bundle.h"
#include "compiler/io/array/array.h"
#include "compiler/io/file/result.h"
#include "compiler/ir/dim.h"

namespace dr::runtime {

// The tables of leaf `faces`, an array of integers, by leaf: of its topology, where it is one of ivec3, and rows
// (compiler/topology/rows.h); none where the bundle asks for none. `symbols` give the number of vertices or targets;
// where they do not, tables of them are left out. Errors: a face of a topology whose vertex is out of range.
io::Result<std::map<size_t, io::Array>> topology_tables(const bundle::BundleT& bundle, size_t faces,
                                                        const io::Array& data, const ir::SymbolValues& symbols);

}  // namespace dr::runtime
