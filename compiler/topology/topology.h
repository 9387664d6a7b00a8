// SPDX-License-Identifier: Apache-2.0
// What `topology(face)` of the language means: integer tables of how the triangles of a mesh hang together. Both hosts
// compute them when the faces are bound: the reference evaluator and the runtime, which share nothing else with the
// compiler but the bundle. No other part of a step runs on the host.
#pragma once

#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

namespace dr::topology {

// How many elements a table has, for F faces, V vertices and E edges.
enum class Count : uint8_t { Edges, Faces, Corners /* 3F */, Starts /* V + 1 */, One };

struct Table {
  std::string_view name;
  int components;  // ints an element
  Count count;
  std::string_view doc;
  bool of_vertices() const { return count == Count::Starts || count == Count::Corners; }
};

// All tables. An edge joins two vertices that are neighbours in some face; edges are sorted by their smaller vertex,
// then by the larger one. A face that names a vertex twice has fewer edges.
std::span<const Table> tables();
const Table* find_table(std::string_view name);  // null if there is none

struct Tables {
  int64_t edges = 0;  // at least 1: a mesh without edges has one of (-1, -1)
  std::map<std::string_view, std::vector<int32_t>> data;
};

// `face` holds three vertices a face. With `vertices` >= 0 each must be below that and the tables of vertices are made;
// with -1 they are left out. The error names the face whose vertex is out of range.
std::variant<Tables, std::string> build(std::span<const int32_t> face, int64_t vertices);

// What hosts tell users whose program asks for `closed` of a mesh that is not; `faces` is the name of the leaf.
std::string not_closed(std::string_view faces);

}  // namespace dr::topology
