// SPDX-License-Identifier: Apache-2.0
// Soft and antialiased pictures (soft_stress.dr) of what meshes, settings and pictures may be, on devices: nothing is
// not finite, coverage and colours stay between 0 and 1, distances are within 2^-22 of the largest coordinate in
// pixels, texels that are not read may be NaN. The evaluator has the same in tests/golden/programs/soft_stress.dr.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <map>
#include <random>

#include "runtime/jit/jit.h"
#include "runtime/runtime.h"
#include "tests/catch.h"
#include "tests/device/compile.h"
#include "tests/device/devices.h"

using namespace dr;
using io::Array;
using test::must;

namespace {

constexpr int64_t kVertices = 120, kFaces = 40;

struct Corner {
  double x = 0, y = 0, w = 0;  // in pixels; w 0: a vertex that is nowhere
};

struct Case {
  std::string name;
  std::vector<Corner> corners;  // the rest of the vertices is nowhere
  std::vector<int32_t> faces;   // the rest has no area
  double sigma = 2.0 / 7;       // of a radius of 2 pixels, by default
  int64_t width = 24, height = 24;
  bool in_front = true;  // of the camera, all of it: distances are known
};

std::vector<Case> cases() {
  std::mt19937 random(7);
  const auto uniform = [&](double low, double high) {
    return low + (high - low) * static_cast<double>(random() % 65536) / 65536;
  };
  std::vector<Case> all;
  const auto soup = [](std::string name, std::vector<Corner> corners) {
    std::vector<int32_t> faces(corners.size());
    for (size_t i = 0; i < faces.size(); ++i) faces[i] = static_cast<int32_t>(i);
    return Case{std::move(name), std::move(corners), std::move(faces)};
  };

  // A hundredth of a pixel wide and up to 60 long; every fifth one without area, every seventh one in one point.
  std::vector<Corner> needles, small;
  for (int f = 0; f < kFaces; ++f) {
    const double x = uniform(-8, 32), y = uniform(-8, 32), w = uniform(1, 2);
    const double dx = f % 7 == 0 ? 0 : uniform(-30, 30), dy = f % 7 == 0 ? 0 : uniform(-30, 30);
    const double wide = f % 5 == 0 ? 0 : 0.01;
    needles.insert(needles.end(), {{x, y, w}, {x + dx, y + dy, w}, {x + 0.3 * dx + wide, y + 0.3 * dy - wide, w}});
    small.insert(small.end(), {{x, y, w}, {x + 0.1, y + 0.02, w}, {x + 0.03, y + 0.1, w}});
  }
  all.push_back(soup("needles", needles));
  all.push_back(soup("faces of a tenth of a pixel", small));

  // Large faces with an edge through the picture, from one far corner to another.
  for (const double size : {1e4, 1e7})
    all.push_back(soup("faces of " + std::to_string(static_cast<int>(size)) + " pixels",
                       {{12.3 - 0.8 * size, 11.1 - 0.6 * size, 1},
                        {12.3 + 0.8 * size, 11.1 + 0.6 * size, 1},
                        {12.3 - size, 11.1 + size, 1},
                        {7.1, 12.2 - size, 2},
                        {9.4, 12.2 + size, 2},
                        {7.1 - size, 3.0, 2}}));

  all.push_back(soup("through the camera", {{8, 8, 1},
                                            {15, 17, -0.5},
                                            {20, 9, 0},
                                            {3, 4, 0.06},
                                            {20, 5, 1e-6},
                                            {9, 21, 1},
                                            {3, 4, -1},
                                            {20, 5, -1},
                                            {9, 21, -1},
                                            {5, 5, 0.05},
                                            {21, 6, 0.05},
                                            {9, 20, 0.05}}));
  all.back().in_front = false;

  std::vector<Corner> same;
  for (int f = 0; f < 8; ++f) same.insert(same.end(), {{6.2, 5.1, 2}, {9.5, 16.1, 2}, {17.2, 7.3, 2}});
  all.push_back(soup("coincident faces", same));
  for (int f = 0; f < 8; ++f)
    for (int k = 0; k < 3; ++k) all.back().faces.push_back(f % 2 == 0 ? k : 2 - k);  // and both ways round

  // A grid whose faces are wound as it comes, three of them at one edge, with holes.
  Case grid{"open and badly wound", {}, {}};
  for (int y = 0; y < 4; ++y)
    for (int x = 0; x < 4; ++x)
      grid.corners.push_back({3 + 5.5 * x + uniform(-1, 1), 3 + 5.5 * y + uniform(-1, 1), uniform(1, 2)});
  for (int32_t y = 0; y < 3; ++y)
    for (int32_t x = 0; x < 3; ++x) {
      const int32_t a = 4 * y + x, b = a + 1, c = a + 4, d = a + 5;
      if (x != 1 || y != 1) grid.faces.insert(grid.faces.end(), {a, random() % 2 ? b : c, random() % 2 ? c : b});
      grid.faces.insert(grid.faces.end(), {b, random() % 2 ? c : d, random() % 2 ? d : c});
    }
  grid.faces.insert(grid.faces.end(), {5, 6, 14, 6, 5, 1});
  all.push_back(grid);

  // An octahedron, closed; its sigma, and pictures of it.
  const auto octahedron = [](double width, double height) {
    const double x = 0.51 * width, y = 0.48 * height;
    return std::vector<Corner>{{x, 0.05 * height, 2}, {0.96 * width, y, 2},    {x, 0.93 * height, 2},
                               {0.04 * width, y, 2},  {x + 0.1 * width, y, 1}, {x - 0.1 * width, y, 3}};
  };
  const std::vector<int32_t> around = {4, 0, 1, 4, 1, 2, 4, 2, 3, 4, 3, 0, 5, 1, 0, 5, 2, 1, 5, 3, 2, 5, 0, 3};
  for (const double sigma : {1.0, 0x1p-8, 1e-9})
    all.push_back({"sigma " + std::to_string(sigma), octahedron(24, 24), around, sigma});
  all.push_back({"1 x 1", octahedron(1, 1), around, 0, 1, 1});
  all.push_back({"4096 x 16", octahedron(4096, 16), around, 0, 4096, 16});
  return all;
}

// Signed distance from a pixel's centre to the edges of a face whose vertices are those that float32 holds.
double distance_to(const Case& c, int face, double x, double y) {
  double least = std::numeric_limits<double>::infinity();
  bool left = true, right = true;
  for (int k = 0; k < 3; ++k) {
    const Corner& a = c.corners[static_cast<size_t>(c.faces[static_cast<size_t>(3 * face + k)])];
    const Corner& b = c.corners[static_cast<size_t>(c.faces[static_cast<size_t>(3 * face + (k + 1) % 3)])];
    const double dx = b.x - a.x, dy = b.y - a.y, px = x - a.x, py = y - a.y, length = dx * dx + dy * dy;
    const double t = length > 0 ? std::clamp((px * dx + py * dy) / length, 0.0, 1.0) : 0;
    least = std::min(least, std::hypot(px - t * dx, py - t * dy));
    left = left && dx * py - dy * px >= 0;
    right = right && dx * py - dy * px <= 0;
  }
  return left || right ? least : -least;
}

// The faces beyond each face's edges, and whether the mesh is closed: what std.mesh makes of a topology, whose number
// of edges would stay that of the first mesh.
std::pair<std::vector<int32_t>, int32_t> neighbours(const std::vector<int32_t>& face) {
  std::map<std::pair<int32_t, int32_t>, std::vector<size_t>> at;  // the sides of each edge, 3 * face + corner
  const auto end = [&](size_t side) { return face[side % 3 == 2 ? side - 2 : side + 1]; };
  for (size_t side = 0; side < face.size(); ++side)
    if (face[side] != end(side)) at[std::minmax(face[side], end(side))].push_back(side);
  std::vector<int32_t> beyond(face.size(), -1);
  int32_t closed = 1;
  for (const auto& [edge, sides] : at) {
    if (sides.size() != 2 || face[sides[0]] == face[sides[1]]) closed = 0;
    if (sides.size() != 2) continue;
    beyond[sides[0]] = static_cast<int32_t>(sides[1] / 3);
    beyond[sides[1]] = static_cast<int32_t>(sides[0] / 3);
  }
  return {beyond, closed};
}

struct Drawn {
  std::map<std::string, Array> outputs;
  std::vector<double> operator[](const std::string& name) const { return outputs.at(name).to_doubles(); }
};

Drawn draw(runtime::Program& program, const Case& c, bool poisoned) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  std::vector<double> place(4 * kVertices, 0), uv(2 * kVertices), texel, weight;
  for (size_t v = 0; v < c.corners.size(); ++v) {
    const Corner& p = c.corners[v];
    place[4 * v] = (p.x / static_cast<double>(c.width) * 2 - 1) * p.w;
    place[4 * v + 1] = (p.y / static_cast<double>(c.height) * 2 - 1) * p.w;
    place[4 * v + 2] = 0.5 * p.w;
    place[4 * v + 3] = p.w;
  }
  for (size_t v = 0; v < uv.size() / 2; ++v) {
    uv[2 * v] = 0.45 + 0.125 * static_cast<double>(v % 3);
    uv[2 * v + 1] = 0.45 + 0.05 * static_cast<double>(v % 5);
  }
  // What lies at (0, 0) is read where there is no face.
  for (int y = 0; y < 8; ++y)
    for (int x = 0; x < 8; ++x) texel.push_back(poisoned && (x < 2 || y < 2) ? nan : 0.5 + 0.05 * x - 0.03 * y);
  for (int64_t i = 0; i < c.width * c.height; ++i) weight.push_back(std::sin(0.7 * static_cast<double>(i)));
  std::vector<int32_t> face(3 * kFaces, 0);
  REQUIRE(c.faces.size() <= face.size());
  std::copy(c.faces.begin(), c.faces.end(), face.begin());
  must(program.bind("place", Array::from_doubles(place, 4)));
  must(program.bind("moved", Array::from_doubles(std::vector<double>(place.size(), 0), 4)));
  must(program.bind("uv", Array::from_doubles(uv, 2)));
  must(program.bind("texel", Array::from_doubles(texel, 1, 8, 8)));
  must(program.bind("weight", Array::from_doubles(weight, 1, c.width, c.height)));
  must(program.bind("sigma", Array::from_doubles(std::vector<double>{c.sigma})));
  const auto [beyond, closed] = neighbours(face);
  must(program.bind("face", Array::from_ints(face, 3)));
  must(program.bind("beyond", Array::from_ints(beyond, 3)));
  must(program.bind("closed", Array::from_ints(std::vector<int32_t>{closed})));
  must(program.run("draw"));
  Drawn out;
  for (const std::string& name : program.outputs("draw")) out.outputs[name] = must(program.output("draw", name));
  return out;
}

struct Worst {
  double distance = 0;  // of what is allowed
  int64_t distances = 0;
};

void check(const Case& c, const Drawn& drawn, bool has_distances, Worst& worst) {
  for (const char* name : {"alpha", "color"}) {
    int64_t out_of_range = 0;
    for (const double x : drawn[name]) out_of_range += x >= 0 && x <= 1 + 1e-6 ? 0 : 1;
    INFO(name);
    CHECK(out_of_range == 0);
  }
  for (const char* name : {"pull", "tint"}) {
    int64_t not_finite = 0;
    for (const double x : drawn[name]) not_finite += std::isfinite(x) ? 0 : 1;
    INFO(name);
    CHECK(not_finite == 0);
  }
  if (!has_distances || !c.in_front) return;
  double largest = 0;
  for (const Corner& p : c.corners) largest = std::max({largest, std::abs(p.x), std::abs(p.y)});
  const double allowed = std::max(largest, static_cast<double>(c.width)) * 0x1p-22;
  const auto found = drawn["distance"], seen = drawn["seen"];
  for (size_t i = 0; i < found.size(); ++i) {
    if (seen[i] < 0 || std::abs(found[i]) > 1e5) continue;  // nothing there, or nothing measured
    const auto x = static_cast<double>(i % static_cast<size_t>(c.width)) + 0.5,
               y = static_cast<double>(i / static_cast<size_t>(c.width)) + 0.5;
    const double off = std::abs(found[i] - distance_to(c, static_cast<int>(seen[i]), x, y));
    worst.distance = std::max(worst.distance, off / allowed);
    ++worst.distances;
  }
}

}  // namespace

TEST_CASE("soft pictures of whatever there may be") {
  // Many layers by coverage alone, and other pictures where compiling is quick: drivers take long for large shaders.
  struct Way {
    int way, layers;
    bool colors, sizes;
  };
  const Way ways[] = {{0, 1, true, true},   {0, 5, false, false}, {1, 3, false, false}, {2, 1, true, false},
                      {2, 8, false, false}, {3, 1, true, false},  {4, 2, true, false}};
  const auto devices = test::devices();
  const char* wanted = std::getenv("DR_STRESS_WAY");
  for (const auto& [name, device] : devices)
    for (const Way& way : ways) {
      if (wanted != nullptr && std::atoi(wanted) != way.way) continue;
      const auto begin = std::chrono::steady_clock::now();
      jit::Options options;
      options.profile = name;
      options.defines = {
          {"way", std::to_string(way.way)}, {"K", std::to_string(way.layers)}, {"colors", way.colors ? "1" : "0"}};
      const auto bundle = test::compile(std::string(DR_SOURCE_DIR) + "/tests/stress/soft_stress.dr", options);
      Worst worst;
      int drawn_cases = 0, covered_cases = 0, pulled_cases = 0;
      std::map<int64_t, runtime::Program> programs;  // by width: a program keeps the sizes of its first run
      for (const Case& c : cases()) {
        if (c.width != 24 && !way.sizes) continue;
        INFO(name << ", way " << way.way << ", K = " << way.layers << ": " << c.name);
        if (programs.count(c.width) == 0) programs.emplace(c.width, must(runtime::Program::load(device, bundle)));
        runtime::Program& program = programs.at(c.width);
        const Drawn clean = draw(program, c, false), poisoned = draw(program, c, true);
        check(c, clean, way.way == 1 || way.way == 2, worst);
        for (const auto& [output, array] : clean.outputs) {
          INFO("with NaN in texels that are not read: " << output);
          CHECK(poisoned.outputs.at(output).bytes == array.bytes);
        }
        const auto alpha = clean["alpha"], pull = clean["pull"];
        ++drawn_cases;
        covered_cases += std::any_of(alpha.begin(), alpha.end(), [](double x) { return x > 0; });
        pulled_cases += std::any_of(pull.begin(), pull.end(), [](double x) { return x != 0; });
      }
      // Not all of nothing.
      CHECK(covered_cases >= drawn_cases - 3);
      CHECK(pulled_cases >= drawn_cases - 4);
      CHECK(worst.distance <= 1);
      if (way.way == 1 || way.way == 2) CHECK(worst.distances > 500);
      std::printf(
          "%s, way %d, K = %d: %d cases, %d covered, %d pulled; %lld distances, at most %.2f of what is allowed; %.1f "
          "s\n",
          name.c_str(), way.way, way.layers, drawn_cases, covered_cases, pulled_cases,
          static_cast<long long>(worst.distances), worst.distance,
          std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
      std::fflush(stdout);
    }
  for (const auto& [name, device] : devices)
    for (const std::string& message : device.validation_messages()) FAIL(name << " validation: " << message);
}
