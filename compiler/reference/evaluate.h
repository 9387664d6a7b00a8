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

// Decisions taken over from elsewhere: for the k-th Raster op of the step (in graph order) its results, and values of
// Pin ops by name (ir/pins.h); a Pin without an entry is computed.
struct Frozen {
  std::vector<std::vector<Image>> rasters;
  std::map<std::string, Image> pins;
};

// Which NaN and Inf are errors. Either way the error names the op that made it from finite operands, or the leaf.
enum class CheckFinite : uint8_t {
  No,
  Results,  // those that reach an output or update; what a Select, an If or a zero adjoint shields is fine
  All,      // the first one that any op makes, also inside regions and the functions of a raster
};

struct Options {
  const Frozen* frozen = nullptr;  // raster results and pinned values to use instead of computing them
  Frozen* record = nullptr;        // where to put the raster results and pinned values
  CheckFinite check_finite = CheckFinite::No;
  // Round every op's result to float32, as a device does. Sums over images are trees, those of scatters are rounded
  // once at their end.
  bool float32 = false;
  int threads = 0;  // 0: as many as the machine has. Results do not depend on it
};

struct EvalError {
  std::string message;
  dsl::Span span;
  std::vector<std::string> notes = {};  // operand values, the run of the step
};

struct StepResult {
  std::map<std::string, Image> outputs;
  std::vector<EvalError> warnings;  // a raster's `keep` that holds outside the hull of the corners
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
  // How often a step counts as having run: its step_index in the next run.
  void set_runs(const std::string& step, int64_t runs) { runs_[step] = runs; }
  int64_t runs(const std::string& step) const {
    const auto it = runs_.find(step);
    return it == runs_.end() ? 0 : it->second;
  }
  const ir::SymbolValues& symbols() const { return symbols_; }
  // The current content of a leaf that is bound, or prepared with a step that needs it.
  const Image& leaf(const std::string& name) const;
  bool has_leaf(const std::string& name) const;
  // Gives params and states that no step has needed what they begin with, where that is known.
  void settle();
  // The same of one leaf: why it has no value, if so.
  std::optional<std::string> settle(const std::string& leaf);
  // Checks that what the steps (all when none is named) read before one of them writes it is bound, fills initial
  // values. Called by run() for its step. One message names all leaves that are missing.
  std::optional<std::string> prepare(std::span<const std::string> steps = {});

  std::variant<StepResult, EvalError> run(const std::string& step, const Options& options = {});
  // Evaluates any root values for the current leaves, without updating anything (tests).
  std::variant<std::vector<Image>, EvalError> evaluate(std::span<const ir::ValueId> values,
                                                       const Options& options = {});

 private:
  std::vector<uint32_t> computed(std::vector<bool>& read) const;
  // `needed` get memory; those of them that are `read` must have data.
  std::optional<std::string> prepare_leaves(std::vector<bool> needed, std::vector<bool> read);
  // Makes the tables of topologies whose faces were bound since (topology.cpp).
  std::optional<std::string> make_tables();
  std::optional<std::string> assign(uint32_t leaf, Image data);

  const ir::Graph& graph_;
  ir::SymbolValues symbols_;
  std::map<std::string, std::string, std::less<>> symbol_origin_;  // which leaf or option set a symbol, for messages
  std::vector<std::optional<Image>> leaves_;
  std::map<std::string, int64_t, std::less<>> runs_;
  std::vector<bool> stale_;  // faces bound since their tables were made, by leaf
};

}  // namespace dr::reference
