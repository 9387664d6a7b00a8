// SPDX-License-Identifier: Apache-2.0
// The reference evaluator: runs a graph in float64 on the CPU. It is the oracle of every other road.
#pragma once

#include <map>
#include <optional>
#include <span>
#include <string>
#include <variant>
#include <vector>

#include "compiler/ir/graph.h"

namespace dr::reference {

// An image in memory. Component-major planes: component c of element (x, y, l) is at
// [((c * layers + l) * height + y) * width + x]. Integers and Bools are integral doubles.
struct Image {
  ir::Type type;
  int64_t width = 1, height = 1, layers = 1;
  std::vector<double> data;
  int64_t count() const { return width * height * layers; }
  double& at(int64_t x, int64_t y, int64_t l, int c) {
    return data[static_cast<size_t>(((c * layers + l) * height + y) * width + x)];
  }
  double at(int64_t x, int64_t y, int64_t l, int c) const { return const_cast<Image*>(this)->at(x, y, l, c); }
};

Image zeros(ir::Type type, int64_t width, int64_t height, int64_t layers);

// Discrete decisions taken over from elsewhere: for the k-th Raster op of the step (in graph order) its results.
struct Frozen {
  std::vector<std::vector<Image>> rasters;
};

struct Options {
  const Frozen* frozen = nullptr;  // raster results to use instead of computing them
  Frozen* record = nullptr;        // where to put the raster results
  // Fail if a NaN or Inf reaches an output or update, naming the first op that made one from finite operands. What a
  // Select or If shields from the results is fine.
  bool check_finite = false;
  int threads = 0;  // 0: as many as the machine has. Results do not depend on it
};

struct StepResult {
  std::map<std::string, Image> outputs;
};

struct EvalError {
  std::string message;
  dsl::Span span;
};

// The memory of a program on the evaluator: leaves by name, and how often each step ran.
class Session {
 public:
  // The graph must outlive the session and have no Grad ops left.
  explicit Session(const ir::Graph& graph);

  // Gives a leaf its data and its extents' symbols their values. Errors: unknown leaf, wrong type, an extent that
  // contradicts an earlier binding (both places named), an extent expression that cannot be solved for its symbol, a
  // table of a topology, which is made from the faces.
  std::optional<std::string> bind(const std::string& leaf, Image data);
  std::optional<std::string> bind_symbol(const std::string& symbol, int64_t value);
  const ir::SymbolValues& symbols() const { return symbols_; }
  // The current content of a leaf (after prepare()).
  const Image& leaf(const std::string& name) const;
  // Checks that everything is bound, fills initial values. Called by run() when needed.
  std::optional<std::string> prepare();

  std::variant<StepResult, EvalError> run(const std::string& step, const Options& options = {});
  // Evaluates any root values for the current leaves, without updating anything (tests).
  std::variant<std::vector<Image>, EvalError> evaluate(std::span<const ir::ValueId> values,
                                                       const Options& options = {});

 private:
  // Makes the tables of topologies whose faces were bound, where nobody gave them (topology.cpp).
  std::optional<std::string> make_tables();
  std::optional<std::string> assign(uint32_t leaf, Image data);

  const ir::Graph& graph_;
  ir::SymbolValues symbols_;
  std::map<std::string, std::string, std::less<>> symbol_origin_;  // which leaf or option set a symbol, for messages
  std::vector<std::optional<Image>> leaves_;
  std::map<std::string, int64_t, std::less<>> runs_;
  std::vector<bool> stale_;  // faces bound since their tables were made, by leaf
  bool prepared_ = false;
};

}  // namespace dr::reference
