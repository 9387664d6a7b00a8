// SPDX-License-Identifier: Apache-2.0
#include "runtime/jit/reference_program.h"

#include <algorithm>

#include "compiler/backend/bundle/bundle.h"
#include "compiler/ir/parse.h"
#include "compiler/passes/passes.h"
#include "compiler/reference/arrays.h"
#include "runtime/data/warnings.h"

namespace dr::jit {

namespace {

using reference::to_array;
using reference::to_image;

const io::Error kMovedFrom{"the program is empty: it was moved from"};

}  // namespace

struct ReferenceProgram::State {
  State(ir::Graph g, std::vector<std::string> all_symbols)
      : graph(std::move(g)), symbols(std::move(all_symbols)), session(graph) {}
  ir::Graph graph;
  std::vector<std::string> symbols;
  reference::Session session;
  std::map<std::string, reference::StepResult> results;
  std::map<std::string, reference::Frozen> frozen, recorded;
  bool float32 = false;
  runtime::Warnings warnings;

  io::Result<io::Array> seen(const std::string& what, const reference::Image& image) {
    auto out = to_array(image);
    if (out) warnings.look(what, *out);
    return out;
  }
};

ReferenceProgram::ReferenceProgram() = default;
ReferenceProgram::ReferenceProgram(ReferenceProgram&&) noexcept = default;
ReferenceProgram& ReferenceProgram::operator=(ReferenceProgram&&) noexcept = default;
ReferenceProgram::~ReferenceProgram() = default;

io::Result<ReferenceProgram> ReferenceProgram::load(std::span<const uint8_t> bytes,
                                                    std::function<void(const std::string&)> warn) {
  const auto bundle = bundle::read(bytes);
  if (const auto* problem = std::get_if<std::string>(&bundle)) return io::Error{*problem};
  auto graph = ir::parse(std::get<bundle::BundleT>(bundle).graph);
  if (const auto* error = std::get_if<ir::ParseError>(&graph))
    return io::Error{"the bundle's graph cannot be read: line " + std::to_string(error->line) + ": " + error->message};
  if (const auto violations = passes::verify(std::get<ir::Graph>(graph)); !violations.empty())
    return io::Error{"the bundle's graph is none: " + violations.front()};
  ReferenceProgram program;
  program.state_ =
      std::make_unique<State>(std::move(std::get<ir::Graph>(graph)), std::get<bundle::BundleT>(bundle).symbols);
  program.state_->warnings = runtime::Warnings(std::move(warn));
  return program;
}

io::Result<void> ReferenceProgram::bind(const std::string& name, const io::Array& data) {
  if (!state_) return kMovedFrom;
  const auto index = state_->graph.leaf_index(name);
  if (!index) return io::Error{"there is no leaf '" + name + "'"};
  const ir::Type type = state_->graph.leaves[*index].type;
  if (!data.consistent())
    return io::Error{"leaf '" + name + "': the array's extent and bytes do not agree, or it is empty"};
  if (type.components() != data.components)
    return io::Error{"leaf '" + name + "' has " + std::to_string(type.components()) +
                     " components an element, the data has " + std::to_string(data.components)};
  if (auto problem = state_->session.bind(name, to_image(data, type))) return io::Error{*problem};
  return {};
}

io::Result<void> ReferenceProgram::bind_symbol(const std::string& symbol, int64_t value) {
  if (!state_) return kMovedFrom;
  const std::vector<std::string>& all = state_->symbols;
  if (std::find(all.begin(), all.end(), symbol) == all.end()) {
    std::string names;
    for (const std::string& s : all) names += (names.empty() ? "" : ", ") + s;
    return io::Error{"there is no symbol '" + symbol + "'; there are: " + names};
  }
  if (value < 1 || value >= int64_t{1} << 31)
    return io::Error{"symbol '" + symbol + "' is " + std::to_string(value) + ", which is not between 1 and 2^31"};
  if (auto problem = state_->session.bind_symbol(symbol, value)) return io::Error{*problem};
  return {};
}

io::Result<void> ReferenceProgram::run(const std::string& step, int times) {
  if (!state_) return kMovedFrom;
  if (times < 1) return io::Error{"a step runs once or more often, found " + std::to_string(times)};
  reference::Options options;
  options.float32 = state_->float32;
  if (const auto it = state_->frozen.find(step); it != state_->frozen.end())
    options.frozen = &it->second;
  else
    options.record = &state_->recorded[step];
  for (int k = 0; k < times; ++k) {
    auto result = state_->session.run(step, options);
    if (const auto* error = std::get_if<reference::EvalError>(&result)) return io::Error{error->message};
    state_->results[step] = std::move(std::get<reference::StepResult>(result));
  }
  return {};
}

io::Result<void> ReferenceProgram::set_runs(const std::string& step, int64_t runs) {
  if (!state_) return kMovedFrom;
  if (!state_->graph.step_index(step)) return io::Error{"there is no step '" + step + "'"};
  if (runs < 0 || runs > INT32_MAX) return io::Error{"a step cannot have run " + std::to_string(runs) + " times"};
  state_->session.set_runs(step, runs);
  return {};
}

io::Result<io::Array> ReferenceProgram::output(const std::string& step, const std::string& name) {
  if (!state_) return kMovedFrom;
  const auto result = state_->results.find(step);
  if (result == state_->results.end()) return io::Error{"step '" + step + "' has not run yet"};
  const auto it = result->second.outputs.find(name);
  if (it == result->second.outputs.end()) return io::Error{"step '" + step + "' has no output '" + name + "'"};
  return state_->seen("output '" + step + "." + name + "'", it->second);
}

io::Result<io::Array> ReferenceProgram::leaf(const std::string& name) {
  if (!state_) return kMovedFrom;
  if (!state_->graph.leaf_index(name)) return io::Error{"there is no leaf '" + name + "'"};
  reference::Session& session = state_->session;
  if (auto problem = session.settle(name)) return io::Error{*problem};
  return state_->seen("leaf '" + name + "'", state_->session.leaf(name));
}

void ReferenceProgram::freeze(const std::string& step, const std::vector<std::vector<io::Array>>& rasters) {
  if (!state_) return;
  if (rasters.empty()) {
    state_->frozen.erase(step);
    return;
  }
  reference::Frozen frozen;
  for (const auto& raster : rasters) {
    frozen.rasters.emplace_back();
    for (const io::Array& a : raster) frozen.rasters.back().push_back(to_image(a, ir::kInt));
  }
  state_->frozen[step] = std::move(frozen);
}

void ReferenceProgram::round_to_float32(bool rounds) {
  if (state_) state_->float32 = rounds;
}

std::vector<std::vector<io::Array>> ReferenceProgram::rasters(const std::string& step) const {
  std::vector<std::vector<io::Array>> out;
  if (!state_) return out;
  const auto it = state_->recorded.find(step);
  if (it == state_->recorded.end()) return out;
  for (const auto& raster : it->second.rasters) {
    out.emplace_back();
    for (const reference::Image& image : raster)
      if (auto array = to_array(image)) out.back().push_back(*std::move(array));
  }
  return out;
}

std::vector<std::pair<std::string, io::Array>> ReferenceProgram::pins(const std::string& step) const {
  std::vector<std::pair<std::string, io::Array>> out;
  if (!state_) return out;
  const auto it = state_->recorded.find(step);
  if (it == state_->recorded.end()) return out;
  for (const auto& [name, image] : it->second.pins)
    if (auto array = to_array(image)) out.emplace_back(name, *std::move(array));
  return out;
}

}  // namespace dr::jit
