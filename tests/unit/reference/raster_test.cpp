// SPDX-License-Identifier: Apache-2.0
// Raster: coverage, order, faces that are dropped, odd corners; recording and freezing.
#include <chrono>
#include <cmath>
#include <cstdio>

#include "tests/catch.h"
#include "tests/unit/reference/support.h"

namespace dr::reference_test {
namespace {

// Faces are given by corners, depth, tag and cull; `keep` holds inside the closed triangle of positive turn.
struct Faces {
  std::string faces = "F";
  std::string layers = "1";
  int nearest = 1;
};

std::string program(const Faces& of, const std::string& w, const std::string& h) {
  const std::string extent = "[" + of.faces + ", 1, " + of.layers + "]";
  const std::string domain = "[" + w + ", " + h + ", " + of.layers + "]";
  std::string text = R"(
    leaf a : vec2EXT input
    leaf b : vec2EXT input
    leaf c : vec2EXT input
    leaf z : floatEXT input
    leaf t : intEXT input
    leaf cull : boolEXT input
    %0 : vec2EXT = leaf text "a"
    %1 : vec2EXT = leaf text "b"
    %2 : vec2EXT = leaf text "c"
    %3 : floatEXT = leaf text "z"
    %4 : intEXT = leaf text "t"
    %5 : boolEXT = leaf text "cull"
    %6 : float = const floats [0]
    RESULTS = raster %0, %1, %2, %3, %4, %0, %1, %2, %5 ints [NEAREST, 5, 3] dims [DOMAIN, FACES] (%10 : vec2, %11 : vec2, %12 : vec2, %13 : float, %14 : int, %15 : vec2) {
      yield %13
    } (%20 : vec2, %21 : vec2, %22 : vec2, %23 : float, %24 : int, %25 : vec2) {
      EDGE30 %20 %21
      EDGE40 %21 %22
      EDGE50 %22 %20
      %60 : bool = land %39, %49
      %61 : bool = land %60, %59
      yield %61
    } (%70 : vec2, %71 : vec2, %72 : vec2, %73 : float, %74 : int, %75 : vec2) {
      yield %74
    }
    step s {
    OUTPUTS
    })";
  const auto replace = [&](const std::string& from, const std::string& to) {
    for (size_t at = text.find(from); at != std::string::npos; at = text.find(from, at + to.size()))
      text.replace(at, from.size(), to);
  };
  // (b.x - a.x) * (p.y - a.y) - (b.y - a.y) * (p.x - a.x) >= 0
  const auto edge = [&](int n, const std::string& from, const std::string& to) {
    const auto v = [&](int k) { return "%" + std::to_string(n + k); };
    replace("EDGE" + std::to_string(n) + " " + from + " " + to,
            v(0) + " : vec2 = sub " + to + ", " + from + "\n" + v(1) + " : vec2 = sub %25, " + from + "\n" + v(2) +
                " : float = extract " + v(0) + " ints [0]\n" + v(3) + " : float = extract " + v(1) + " ints [1]\n" +
                v(4) + " : float = mul " + v(2) + ", " + v(3) + "\n" + v(5) + " : float = extract " + v(0) +
                " ints [1]\n" + v(6) + " : float = extract " + v(1) + " ints [0]\n" + v(7) + " : float = mul " + v(5) +
                ", " + v(6) + "\n" + v(8) + " : float = sub " + v(4) + ", " + v(7) + "\n" + v(9) + " : bool = le %6, " +
                v(8));
  };
  edge(30, "%20", "%21");
  edge(40, "%21", "%22");
  edge(50, "%22", "%20");
  std::string results, outputs;
  for (int k = 0; k < of.nearest; ++k) {
    const std::string rank = std::to_string(k), face = "%" + std::to_string(100 + 2 * k),
                      tag = "%" + std::to_string(101 + 2 * k);
    results += (k > 0 ? ", " : "") + face + " : int" + domain + ", " + tag + " : int" + domain;
    outputs += "output face" + rank + " " + face + "\noutput tag" + rank + " " + tag + "\n";
  }
  replace("RESULTS", results);
  replace("OUTPUTS", outputs);
  replace("DOMAIN", domain.substr(1, domain.size() - 2));
  replace("FACES", of.faces);
  replace("NEAREST", std::to_string(of.nearest));
  replace("EXT", extent);
  return text;
}

struct Face {
  double a[2], b[2], c[2];
  double z = 0;
  double tag = 0;
  bool cull = false;
};

Images leaves(const std::vector<Face>& faces, int64_t layers = 1) {
  const auto n = static_cast<int64_t>(faces.size()) / layers;
  Images out{{"a", reference::zeros(ir::vec(2), n, 1, layers)}, {"b", reference::zeros(ir::vec(2), n, 1, layers)},
             {"c", reference::zeros(ir::vec(2), n, 1, layers)}, {"z", reference::zeros(ir::kFloat, n, 1, layers)},
             {"t", reference::zeros(ir::kInt, n, 1, layers)},   {"cull", reference::zeros(ir::kBool, n, 1, layers)}};
  for (size_t i = 0; i < faces.size(); ++i) {
    const int64_t f = static_cast<int64_t>(i) % n, l = static_cast<int64_t>(i) / n;
    for (int c = 0; c < 2; ++c) {
      out.at("a").at(f, 0, l, c) = faces[i].a[c];
      out.at("b").at(f, 0, l, c) = faces[i].b[c];
      out.at("c").at(f, 0, l, c) = faces[i].c[c];
    }
    out.at("z").at(f, 0, l, 0) = faces[i].z;
    out.at("t").at(f, 0, l, 0) = faces[i].tag;
    out.at("cull").at(f, 0, l, 0) = faces[i].cull ? 1 : 0;
  }
  return out;
}

// Covers the pixels x + y < n, all of them beyond (0, 0).
Face corner_triangle(double n, double z) { return {{0, 0}, {n + 0.25, 0}, {0, n + 0.25}, z, 3, false}; }

TEST_CASE("the nearer of two triangles is seen, the other is second") {
  const Images out = run(program({.nearest = 2}, "4", "3"),
                         leaves({corner_triangle(4, 0.5), {{1, 0}, {4, 0}, {1, 3}, 0.25, 9, false}}));
  CHECK(out.at("face0").data == Numbers{0, 1, 1, 1, 0, 1, 1, -1, 0, 1, -1, -1});
  CHECK(out.at("tag0").data == Numbers{3, 9, 9, 9, 3, 9, 9, 0, 3, 9, 0, 0});
  CHECK(out.at("face1").data == Numbers{-1, 0, 0, 0, -1, 0, 0, -1, -1, 0, -1, -1});
  CHECK(out.at("tag1").data == Numbers{0, 3, 3, 3, 0, 3, 3, 0, 0, 3, 0, 0});
}

TEST_CASE("equal keys go by the face's number") {
  // The depths differ by less than a key's step, the later face being nearer; and beyond [0, 1] they are clamped.
  const Images out = run(program({.nearest = 3}, "1", "1"),
                         leaves({corner_triangle(1, 0.5 + 1e-9), corner_triangle(1, 7), corner_triangle(1, 0.5),
                                 corner_triangle(1, -2), corner_triangle(1, -1)}));
  CHECK(out.at("face0").data == Numbers{3});
  CHECK(out.at("face1").data == Numbers{4});
  CHECK(out.at("face2").data == Numbers{0});
}

TEST_CASE("a face is dropped when it is culled, its depth is NaN, or a corner is") {
  Face culled = corner_triangle(2, 0), no_depth = corner_triangle(2, kNaN), no_corner = corner_triangle(2, 0);
  culled.cull = true;
  no_corner.b[0] = kNaN;
  Images out = run(program({}, "2", "2"), leaves({culled, no_depth, no_corner}));
  CHECK(out.at("face0").data == Numbers{-1, -1, -1, -1});
  out = run(program({}, "2", "2"), leaves({culled, no_depth, no_corner, corner_triangle(2, 1)}));
  CHECK(out.at("face0").data == Numbers{3, 3, 3, -1});
}

TEST_CASE("huge and infinite corners") {
  const Face huge{{-1e30, -1e30}, {1e30, -1e30}, {0, 1e30}, 0, 1, false};
  CHECK(run(program({}, "3", "2"), leaves({huge})).at("face0").data == Numbers(6, 0.0));
  const Face outside{{1e30, 1e30}, {2e30, 1e30}, {1e30, 2e30}, 0, 1, false};
  CHECK(run(program({}, "3", "2"), leaves({outside})).at("face0").data == Numbers(6, -1.0));
  // `keep` decides, here with infinities in its products.
  const Face infinite{{0, 0}, {kInfinity, 0}, {0, 2.5}, 0, 1, false};
  const Images out = run(program({}, "2", "2"), leaves({infinite}));
  CHECK(out.at("face0").count() == 4);
}

TEST_CASE("faces with a corner on a pixel's centre, and smaller than a pixel") {
  // Exactly the centre (1.5, 0.5); a sliver between centres; a triangle around (2.5, 1.5).
  const Images out = run(program({}, "4", "2"), leaves({{{1.5, 0.5}, {1.5, 0.5}, {1.5, 0.5}, 0, 0, false},
                                                        {{0.6, 0.0}, {0.9, 0.0}, {0.9, 2.0}, 0, 0, false},
                                                        {{2.4, 1.4}, {2.6, 1.4}, {2.5, 1.6}, 0, 0, false}}));
  CHECK(out.at("face0").data == Numbers{-1, 0, -1, -1, -1, -1, 2, -1});
}

TEST_CASE("each layer has faces of its own") {
  const Images out =
      run(program({.faces = "F", .layers = "L", .nearest = 1}, "2", "1"),
          leaves({corner_triangle(1, 0), corner_triangle(2, 1), corner_triangle(2, 0), corner_triangle(1, 1)}, 2));
  CHECK(out.at("face0").data == Numbers{0, 1, 0, 0});
  CHECK(out.at("face0").layers == 2);
}

TEST_CASE("a picture of one pixel") {
  CHECK(run(program({}, "1", "1"), leaves({corner_triangle(1, 0)})).at("face0").data == Numbers{0});
  CHECK(run(program({}, "1", "1"), leaves({corner_triangle(-1, 0)})).at("face0").data == Numbers{-1});
}

TEST_CASE("more faces and pixels than one batch and band hold") {
  // 40 x 40 pixels; face f covers x + y < 2 f and is the farther the larger it is.
  std::vector<Face> faces;
  for (int f = 0; f < 50; ++f) faces.push_back(corner_triangle(2 * f, f / 64.0));
  const Images out = run(program({.nearest = 2}, "40", "40"), leaves(faces));
  bool right = true;
  for (int64_t y = 0; y < 40; ++y) {
    for (int64_t x = 0; x < 40; ++x) {
      const int64_t first = (x + y) / 2 + 1;
      right &= out.at("face0").at(x, y, 0, 0) == static_cast<double>(first < 50 ? first : -1);
      right &= out.at("face1").at(x, y, 0, 0) == static_cast<double>(first + 1 < 50 ? first + 1 : -1);
    }
  }
  CHECK(right);
}

TEST_CASE("time of a raster of many faces", "[.][benchmark]") {
  std::vector<Face> faces;
  for (int f = 0; f < 20000; ++f) {
    const double x = f * 37 % 509 * 0.5, y = f * 101 % 503 * 0.5, z = f % 977 / 977.0;
    faces.push_back({{x, y}, {x + 4, y}, {x, y + 4}, z, 0, false});
  }
  const ir::Graph graph = parse(program({.nearest = 4}, "256", "256"));
  const Images data = leaves(faces);
  const auto begin = std::chrono::steady_clock::now();
  run(graph, data);
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  std::printf("raster of 20000 faces, 500000 candidates: %.3f s\n", seconds);
}

TEST_CASE("six corners, captured values and regions in a region") {
  // The hull of the second triangle proposes; `keep` reads a mask of the picture in a branch.
  const Images out =
      run(R"(
    leaf mask : float[W, H] input
    leaf a : vec2[F] input
    %0 : float[W, H] = leaf text "mask"
    %1 : vec2[F] = leaf text "a"
    %2 : vec2 = const floats [0, 0]
    %3 : vec2 = const floats [3, 0]
    %4 : vec2 = const floats [3, 2]
    %5 : bool = const floats [0]
    %6 : float = const floats [0.5]
    %7 : int[W, H], %8 : int[W, H] = raster %1, %1, %1, %1, %2, %3, %4, %5 ints [1, 1, 6] dims [W, H, 1, F] (%9 : vec2, %10 : vec2) {
      yield %6
    } (%11 : vec2, %12 : vec2) {
      %13 : float = extract %12 ints [0]
      %14 : bool = lt %6, %13
      %15 : bool[W, H] = if %14 dims [W, H, 1] yields [element] {
        %16 : bool[W, H] = lt %6, %0
        yield %16
      } {
        %17 : float = extract %11 ints [0]
        %18 : bool = lt %17, %6
        yield %18
      }
      yield %15
    } (%19 : vec2, %20 : vec2) {
      %21 : float = extract %20 ints [0]
      %22 : int = convert %21 ints [1]
      yield %22
    }
    step s {
      output face %7
      output tag %8
    })",
          {{"mask", image("float", 3, 2, 1, {0, 1, 0, 1, 1, 1})}, {"a", image("vec2", 1, 1, 1, {0, 0})}});
  // Column 0 keeps by the field's x, the others where the mask is set.
  CHECK(out.at("face").data == Numbers{0, 0, -1, 0, 0, 0});
  CHECK(out.at("tag").data == Numbers{0, 1, 0, 0, 1, 2});
}

TEST_CASE("tags have four bits") {
  Face face = corner_triangle(1, 0);
  face.tag = -1;
  CHECK(run(program({}, "1", "1"), leaves({face})).at("tag0").data == Numbers{15});
}

TEST_CASE("raster results are recorded, and frozen ones are taken over") {
  const ir::Graph graph = parse(program({}, "2", "1"));
  const Images data = leaves({corner_triangle(1, 0), corner_triangle(2, 1)});
  reference::Frozen frozen;
  reference::Options options;
  options.record = &frozen;
  CHECK(run(graph, data, options).at("face0").data == Numbers{0, 1});
  REQUIRE(frozen.rasters.size() == 1);
  REQUIRE(frozen.rasters[0].size() == 2);
  CHECK(frozen.rasters[0][0].data == Numbers{0, 1});
  CHECK(frozen.rasters[0][1].data == Numbers{3, 3});

  frozen.rasters[0][0].data = {1, -1};
  options = {};
  options.frozen = &frozen;
  CHECK(run(graph, data, options).at("face0").data == Numbers{1, -1});

  frozen.rasters[0][0] = row("int", {1, 1, 1});
  CHECK(error(graph, data, options).message == "the frozen results of raster 0 have another extent");
  frozen.rasters.clear();
  CHECK(error(graph, data, options).message == "the frozen decisions do not have the results of raster 0");
}

}  // namespace
}  // namespace dr::reference_test
