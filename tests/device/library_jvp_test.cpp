// SPDX-License-Identifier: Apache-2.0
// Forward mode against reverse mode for every function of the library: <w, J v> = <J^T w, v>, in the evaluator. The
// operands are those of the table of accuracy.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <set>

#include "compiler/reference/evaluate.h"
#include "tests/catch.h"
#include "tests/device/accuracy/library.h"
#include "tests/device/accuracy/library_draw.h"
#include "tests/device/accuracy/library_text.h"
#include "tests/must.h"

using namespace dr;
namespace library = accuracy::library;
using library::Function;
using library::Operand;
using reference::Image;
using Images = std::map<std::string, Image>;

namespace {

constexpr double kTolerance = 1e-12;  // of the sum of the terms' sizes
constexpr size_t kTogether = 10;

Images run(reference::Session& session, const std::string& step) {
  auto result = session.run(step, {});
  if (const auto* error = std::get_if<reference::EvalError>(&result)) benchmark::stop(step + ": " + error->message);
  return std::move(std::get<reference::StepResult>(result).outputs);
}

Image zeros(const ir::Graph& graph, const std::string& name) {
  const ir::Leaf& leaf = graph.leaves[*graph.leaf_index(name)];
  const auto size = [](const ir::Dim& d) { return *d.evaluate({}); };
  return reference::zeros(leaf.type, size(leaf.extent.w), size(leaf.extent.h), size(leaf.extent.l));
}

// Functions of the library without a row of a gradient, and why. `library_accuracy_test` asks that the table has all.
struct Without {
  const char* why;
  std::vector<const char*> functions;
};

const std::vector<Without>& without_derivative() {
  static const std::vector<Without> kAll = {
      {"integers or decisions: there is no derivative",
       {"coverage.crowded",
        "coverage.crowded_faces",
        "environment.cube_face",
        "loss.known",
        "mesh.beyond",
        "mesh.globe_face",
        "mesh.icosphere_cell",
        "mesh.icosphere_face",
        "mesh.icosphere_uv_face",
        "mesh.inside_out",
        "mesh.neighbours",
        "mesh.neighbours_of",
        "mesh.rhomb_vertex",
        "mesh.ring_corner",
        "points.nearest",
        "random.bits",
        "random.combined",
        "random.directions",
        "random.integer",
        "random.pcg4d",
        "random.scrambled_sobol",
        "random.sobol",
        "random.sobol_bits",
        "random.stirred",
        "raster.nearest",
        "shadow.point_view",
        "strands.segments",
        "strands.strand_of",
        "texture.below_2_30",
        "texture.inverse_uv",
        "texture.shuffled",
        "texture.sobol_turn",
        "texture.unshuffled",
        "tiles.bit",
        "tiles.blocks",
        "tiles.border",
        "tiles.fitted",
        "tiles.rows",
        "tiles.touched",
        "tiles.with_tiles"}},
      {"made of integers alone",
       {"environment.solid_angle", "material.energies", "mesh.face_count",  "mesh.globe_position", "mesh.globe_uv",
        "mesh.icosphere_position", "mesh.icosphere_uv", "mesh.rhomb_point", "nn.places",           "nn.random_weights",
        "optim.progress",          "random.normal",     "random.normal2",   "random.normal4",      "random.normal_pair",
        "random.uniform",          "random.uniform2",   "random.uniform3",  "random.uniform4",     "random.unit",
        "texture.sobol_jitter"}},
      {"what a step does, which has no derivative",
       {"optim.adam", "optim.adamw", "optim.smooth_adam", "optim.momentum", "optim.sgd", "solve.levenberg_marquardt"}},
      {"rows of what it is made of ask",
       {"hair.shade", "shadow.map", "shadow.map_of", "shadow.plain_map", "strands.interpolate"}},
  };
  return kAll;
}

// Some functions in one program, and what draws their operands.
class Group {
 public:
  explicit Group(std::span<const Function> functions)
      : functions_(functions),
        graph_(library::graph_of(library::transpose_text(functions))),
        draw_graph_(library::graph_of(library::draw_text(functions))),
        session_(graph_),
        draw_(draw_graph_) {}

  void check(size_t k) {
    const Function& f = functions_[k];
    library::Draw random(1 + std::hash<std::string>{}(f.name + f.part) % 1000);
    bind(k, random);
    const Images found = run(session_, library::step_name(k));
    double left = 0, right = 0, terms = 0;
    size_t lost = 0;
    for (const std::string& x : library::moved_operands(f)) {
      const Image &forward = found.at("j_" + x), &back = found.at("d_" + x);
      lost += add(left, terms, forward, given_.at(library::seed_name(k)));
      lost += add(right, terms, back, given_.at(library::along_name(k, x)));
    }
    INFO(f.name << " " << f.part << ": <w, J v> = " << left << ", <J^T w, v> = " << right << ", terms " << terms
                << ", not finite " << lost);
    if (std::getenv("SHOW") != nullptr)
      std::printf("%-8.2g %-8.2g %zu %s %s\n", std::abs(left - right) / terms, terms, lost, f.name.c_str(),
                  f.part.c_str());
    CHECK(terms > 0);
    CHECK(lost == 0);
    CHECK(std::abs(left - right) <= kTolerance * terms);
  }

 private:
  static size_t add(double& sum, double& terms, const Image& a, const Image& b) {
    REQUIRE(a.data.size() == b.data.size());
    size_t lost = 0;
    for (size_t i = 0; i < a.data.size(); ++i) {
      const double term = a.data[i] * b.data[i];
      if (!std::isfinite(term)) {
        ++lost;
        continue;
      }
      sum += term;
      terms += std::abs(term);
    }
    return lost;
  }

  void give(reference::Session& session, const std::string& leaf, const Image& image) {
    if (const auto problem = session.bind(leaf, image)) benchmark::stop(*problem);
  }

  template <class Element>
  Image filled(const ir::Graph& graph, const std::string& leaf, const Element& element) {
    Image image = zeros(graph, leaf);
    const auto n = static_cast<size_t>(image.count());
    for (size_t i = 0; i < n; ++i) {
      const std::vector<double> values = element(image.type);
      for (size_t c = 0; c < values.size(); ++c) image.data[c * n + i] = values[c];
    }
    return image;
  }

  void bind(size_t k, library::Draw& random) {
    const Function& f = functions_[k];
    given_.clear();
    for (const Operand& o : f.operands) {
      if (!o.from.empty()) continue;
      const std::string name = library::leaf_name(k, o);
      const bool drawn = draw_graph_.leaf_index(name).has_value();
      const Image image =
          filled(drawn ? draw_graph_ : graph_, name, [&](const ir::Type& type) { return random.element(o, type); });
      if (drawn) give(draw_, name, image);
      if (graph_.leaf_index(name)) give(session_, name, image);
    }
    if (draw_graph_.step_index(library::step_name(k))) {
      const Images made = run(draw_, library::step_name(k));
      for (const Operand& o : f.operands)
        if (const auto found = made.find(o.name); found != made.end())
          give(session_, library::leaf_name(k, o), found->second);
    }
    const auto numbers = [&](const ir::Type& type) { return random.adjoint(type, true); };
    std::vector<std::string> others{library::seed_name(k)};
    for (const std::string& x : library::moved_operands(f)) others.push_back(library::along_name(k, x));
    for (const std::string& name : others) {
      given_.emplace(name, filled(graph_, name, numbers));
      give(session_, name, given_.at(name));
    }
  }

  std::span<const Function> functions_;
  ir::Graph graph_, draw_graph_;
  reference::Session session_, draw_;
  Images given_;
};

// A quarter of the elements, for functions of one element: the derivative is asked at a thousand places.
void take_fewer(Function& f) {
  const bool is_of_elements = !f.result.ends_with(']') && f.before.empty() &&
                              std::ranges::all_of(f.operands, [](const Operand& o) { return o.extent.empty(); });
  if (!is_of_elements) return;
  const std::string fewer = "[" + std::to_string(library::kSide / 2) + ", " + std::to_string(library::kSide / 2) + "]";
  for (Operand& o : f.operands) o.extent = fewer;
  f.result += fewer;
}

}  // namespace

TEST_CASE("functions of the library that jvp is not asked of have a reason") {
  std::set<std::string> asked, all;
  for (const Function& f : library::functions()) {
    all.insert(f.name);
    if (!library::moved_operands(f).empty()) asked.insert(f.name);
  }
  for (const library::Elsewhere& other : library::elsewhere()) all.insert(other.function);
  std::set<std::string> excused;
  for (const Without& group : without_derivative()) excused.insert(group.functions.begin(), group.functions.end());
  for (const std::string& name : all) {
    INFO(name);
    CHECK(asked.contains(name) != excused.contains(name));
  }
  for (const std::string& name : excused) {
    INFO(name << " is not there any more");
    CHECK(all.contains(name));
  }
}

TEST_CASE("jvp is the transpose of grad for every function of the library") {
  std::vector<Function> functions = library::functions();
  const char* wanted = std::getenv("DR_ACCURACY_ONLY");
  std::erase_if(functions, [&](const Function& f) {
    if (wanted != nullptr && f.name.find(wanted) == std::string::npos) return true;
    return library::moved_operands(f).empty();
  });
  for (Function& f : functions) take_fewer(f);
  if (wanted == nullptr) CHECK(functions.size() > 200);
  for (size_t first = 0; first < functions.size(); first += kTogether) {
    Group group(std::span<const Function>(functions).subspan(first, std::min(kTogether, functions.size() - first)));
    for (size_t k = first; k < std::min(first + kTogether, functions.size()); ++k) group.check(k - first);
  }
}
