// SPDX-License-Identifier: Apache-2.0
#include "compiler/topology/topology.h"

#include <algorithm>
#include <tuple>

namespace dr::topology {

namespace {

constexpr Table kTables[] = {
    {"edge", 2, Count::Edges, "the two vertices of each edge, the smaller one first"},
    {"edge_face", 2, Count::Edges, "the first two faces at each edge, -1 where there are fewer"},
    {"edge_faces", 1, Count::Edges, "how many faces meet at each edge: 1 on a border"},
    {"face_edge", 3, Count::Faces, "the edges from each corner of a face to the next, -1 where both are one vertex"},
    {"closed", 1, Count::One, "1 if each edge has two faces that run along it in opposite directions, else 0"},
    {"vertex_start", 1, Count::Starts, "where the corners of each vertex start in `vertex_corner`, and their end"},
    {"vertex_corner", 1, Count::Corners, "3 * face + corner of all corners, by vertex, then by number"},
};

// One side of a face, as an edge.
struct Side {
  int32_t low, high;
  int32_t face, side;
  bool forward;  // runs from the smaller vertex to the larger one
};

void add_edges(std::span<const int32_t> face, Tables& out) {
  std::vector<Side> sides;
  sides.reserve(face.size());
  for (size_t f = 0; f < face.size() / 3; ++f) {
    for (size_t k = 0; k < 3; ++k) {
      const int32_t a = face[3 * f + k], b = face[3 * f + (k + 1) % 3];
      if (a == b) continue;
      sides.push_back({std::min(a, b), std::max(a, b), static_cast<int32_t>(f), static_cast<int32_t>(k), a < b});
    }
  }
  std::ranges::sort(sides, {}, [](const Side& s) { return std::tuple(s.low, s.high, s.face, s.side); });

  std::vector<int32_t>&edge = out.data["edge"], &edge_face = out.data["edge_face"], &count = out.data["edge_faces"];
  std::vector<int32_t>& face_edge = out.data["face_edge"];
  face_edge.assign(face.size(), -1);
  bool closed = !sides.empty();
  for (size_t i = 0; i < sides.size();) {
    size_t end = i;
    while (end < sides.size() && sides[end].low == sides[i].low && sides[end].high == sides[i].high) ++end;
    const auto number = static_cast<int32_t>(count.size());
    edge.insert(edge.end(), {sides[i].low, sides[i].high});
    // A face that runs there and back along an edge is one face.
    int32_t second = -1, faces = 1;
    for (size_t k = i + 1; k < end; ++k) {
      if (sides[k].face == sides[k - 1].face) continue;
      if (++faces == 2) second = sides[k].face;
    }
    edge_face.insert(edge_face.end(), {sides[i].face, second});
    count.push_back(faces);
    closed = closed && faces == 2 && end - i == 2 && sides[i].forward != sides[i + 1].forward;
    for (; i < end; ++i) face_edge[static_cast<size_t>(3 * sides[i].face + sides[i].side)] = number;
  }
  if (count.empty()) {
    edge = edge_face = {-1, -1};
    count = {0};
  }
  out.edges = static_cast<int64_t>(count.size());
  out.data["closed"] = {closed ? 1 : 0};
}

void add_vertices(std::span<const int32_t> face, int64_t vertices, Tables& out) {
  std::vector<int32_t>&start = out.data["vertex_start"], &corner = out.data["vertex_corner"];
  start.assign(static_cast<size_t>(vertices) + 1, 0);
  for (const int32_t v : face) ++start[static_cast<size_t>(v) + 1];
  for (size_t v = 1; v < start.size(); ++v) start[v] += start[v - 1];
  corner.resize(face.size());
  std::vector<int32_t> next(start.begin(), start.end() - 1);
  for (size_t c = 0; c < face.size(); ++c)
    corner[static_cast<size_t>(next[static_cast<size_t>(face[c])]++)] = static_cast<int32_t>(c);
}

}  // namespace

std::span<const Table> tables() { return kTables; }

const Table* find_table(std::string_view name) {
  const auto found = std::ranges::find(kTables, name, &Table::name);
  return found == std::end(kTables) ? nullptr : found;
}

std::variant<Tables, std::string> build(std::span<const int32_t> face, int64_t vertices) {
  for (size_t c = 0; c < face.size(); ++c) {
    if (face[c] >= 0 && (vertices < 0 || face[c] < vertices)) continue;
    return "face " + std::to_string(c / 3) + " names the vertex " + std::to_string(face[c]) +
           (vertices >= 0 ? " of " + std::to_string(vertices) + " vertices" : ", expected at least 0");
  }
  Tables out;
  add_edges(face, out);
  if (vertices >= 0) add_vertices(face, vertices, out);
  return out;
}

std::string not_closed(std::string_view faces) {
  return "the mesh '" + std::string(faces) +
         "' is not closed: some edge does not have two faces that run along it in opposite directions. Its faces show "
         "both sides";
}

}  // namespace dr::topology
