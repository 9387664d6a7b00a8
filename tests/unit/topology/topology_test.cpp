// SPDX-License-Identifier: Apache-2.0
// Tables of meshes that can be drawn on paper, and what holds for all of them.
#include "compiler/topology/topology.h"

#include <random>
#include <set>

#include "tests/catch.h"

using namespace dr;
using topology::Tables;
using Numbers = std::vector<int32_t>;

namespace {

Tables made(const Numbers& face, int64_t vertices) {
  auto built = topology::build(face, vertices);
  REQUIRE(std::holds_alternative<Tables>(built));
  return std::get<Tables>(std::move(built));
}

std::string wrong(const Numbers& face, int64_t vertices) {
  const auto built = topology::build(face, vertices);
  const auto* error = std::get_if<std::string>(&built);
  return error ? *error : "";
}

}  // namespace

TEST_CASE("two triangles that share an edge") {
  Tables t = made({0, 1, 2, 2, 1, 3}, 4);
  CHECK(t.edges == 5);
  CHECK(t.data["edge"] == Numbers{0, 1, 0, 2, 1, 2, 1, 3, 2, 3});
  CHECK(t.data["edge_face"] == Numbers{0, -1, 0, -1, 0, 1, 1, -1, 1, -1});
  CHECK(t.data["edge_faces"] == Numbers{1, 1, 2, 1, 1});
  CHECK(t.data["face_edge"] == Numbers{0, 2, 1, 2, 3, 4});
  CHECK(t.data["vertex_start"] == Numbers{0, 1, 3, 5, 6});
  CHECK(t.data["vertex_corner"] == Numbers{0, 1, 4, 2, 3, 5});
  CHECK(t.data["closed"] == Numbers{0});
}

TEST_CASE("a mesh is closed if each edge is run along once in each direction") {
  const Numbers tetrahedron{0, 1, 2, 0, 3, 1, 1, 3, 2, 2, 3, 0};
  CHECK(made(tetrahedron, -1).data["closed"] == Numbers{1});
  Numbers turned = tetrahedron;
  std::swap(turned[0], turned[1]);
  CHECK(made(turned, -1).data["closed"] == Numbers{0});
  Numbers doubled = tetrahedron;
  doubled.insert(doubled.end(), {0, 1, 2});
  CHECK(made(doubled, -1).data["closed"] == Numbers{0});
  CHECK(made(doubled, -1).data["edge_faces"][0] == 3);
}

TEST_CASE("faces that are points or lines, and vertices without faces") {
  Tables point = made({1, 1, 1}, 3);
  CHECK(point.edges == 1);
  CHECK(point.data["edge"] == Numbers{-1, -1});
  CHECK(point.data["edge_faces"] == Numbers{0});
  CHECK(point.data["face_edge"] == Numbers{-1, -1, -1});
  CHECK(point.data["closed"] == Numbers{0});
  CHECK(point.data["vertex_start"] == Numbers{0, 0, 3, 3});
  // There and back: one edge, met twice by one face.
  Tables line = made({0, 1, 0}, -1);
  CHECK(line.edges == 1);
  CHECK(line.data["face_edge"] == Numbers{0, 0, -1});
  CHECK(line.data["edge_face"] == Numbers{0, -1});
  CHECK(line.data["closed"] == Numbers{0});
  CHECK(!line.data.contains("vertex_start"));
}

TEST_CASE("vertices out of range are named") {
  CHECK(wrong({0, 1, 2, 0, 1, 3}, 3) == "face 1 names the vertex 3 of 3 vertices");
  CHECK(wrong({0, 1, 2}, 0) == "face 0 names the vertex 0 of 0 vertices");
  CHECK(wrong({0, -1, 2}, -1) == "face 0 names the vertex -1, expected at least 0");
}

TEST_CASE("tables of random faces agree with each other") {
  std::mt19937 random(11);
  for (int round = 0; round < 50; ++round) {
    const int vertices = 3 + round % 20, faces = 1 + round;
    std::uniform_int_distribution<int32_t> vertex(0, vertices - 1);
    Numbers face;
    for (int i = 0; i < 3 * faces; ++i) face.push_back(vertex(random));
    Tables t = made(face, vertices);
    std::set<std::pair<int32_t, int32_t>> edges;
    std::set<std::pair<int32_t, int32_t>> meetings;  // of a face and an edge
    for (int f = 0; f < faces; ++f) {
      for (int k = 0; k < 3; ++k) {
        const auto at = static_cast<size_t>(3 * f + k);
        const int32_t a = face[at], b = face[static_cast<size_t>(3 * f + (k + 1) % 3)], e = t.data["face_edge"][at];
        CHECK((e == -1) == (a == b));
        if (e < 0) continue;
        meetings.emplace(f, e);
        edges.emplace(std::min(a, b), std::max(a, b));
        CHECK(t.data["edge"][static_cast<size_t>(2 * e)] == std::min(a, b));
        CHECK(t.data["edge"][static_cast<size_t>(2 * e + 1)] == std::max(a, b));
      }
    }
    int32_t counted = 0;
    for (const int32_t n : t.data["edge_faces"]) counted += n;
    CHECK(counted == static_cast<int32_t>(meetings.size()));
    if (!edges.empty()) CHECK(t.edges == static_cast<int64_t>(edges.size()));
    for (int v = 0; v < vertices; ++v) {
      for (int32_t c = t.data["vertex_start"][static_cast<size_t>(v)];
           c < t.data["vertex_start"][static_cast<size_t>(v + 1)]; ++c)
        CHECK(face[static_cast<size_t>(t.data["vertex_corner"][static_cast<size_t>(c)])] == v);
    }
    CHECK(t.data["vertex_start"].back() == 3 * faces);
  }
}
