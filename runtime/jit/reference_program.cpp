// SPDX-License-Identifier: Apache-2.0
#include "runtime/jit/reference_program.h"

#include <algorithm>

#include "compiler/backend/bundle/bundle.h"
#include "compiler/ir/initial_step.h"
#include "compiler/ir/parse.h"
#include "compiler/passes/passes.h"
#include "compiler/reference/arrays.h"
#include "runtime/data/warnings.h"

namespace dr::jit {

namespace {

using reference::to_array;
using reference::to_image;

const io::Error kMovedFrom{"the program is empty: it was moved from"};

// Functions that take memory as data asks for: exceptions stay inside.
template <class F>
auto guarded(const F& f) -> decltype(f()) {
  try {
    return f();
  } catch (const std::bad_alloc&) {
    return io::Error{"this machine has not enough memory for the program's data", io::Blame::Device};
  } catch (const std::exception& e) {
    return io::Error{e.what()};
  }
}

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

  // What a user knows no step by.
  std::optional<io::Error> unknown_step(const std::string& name) const {
    std::string all;
    for (const ir::Step& step : graph.steps) {
      if (!ir::leaf_of_initial_step(step.name).empty()) continue;
      if (step.name == name) return std::nullopt;
      all += (all.empty() ? "" : ", ") + step.name;
    }
    return io::Error{"there is no step '" + name + "'; there are: " + all};
  }

  io::Error no_leaf(const std::string& name) const {
    std::string all;
    for (const ir::Leaf& leaf : graph.leaves)
      if (leaf.table.empty()) all += (all.empty() ? "" : ", ") + leaf.name;
    return io::Error{"there is no leaf '" + name + "'; there are: " + all};
  }

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
  if (!index) return state_->no_leaf(name);
  const ir::Type type = state_->graph.leaves[*index].type;
  if (!data.consistent())
    return io::Error{"leaf '" + name + "': the array's extent and bytes do not agree, or it is empty"};
  if (type.components() != data.components)
    return io::Error{"leaf '" + name + "' has " + std::to_string(type.components()) +
                     " components an element, the data has " + std::to_string(data.components)};
  return guarded([&]() -> io::Result<void> {
    if (auto problem = state_->session.bind(name, to_image(data, type))) return io::Error{*problem};
    return {};
  });
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
  if (auto problem = state_->unknown_step(step)) return *problem;
  if (times < 1) return io::Error{"a step runs once or more often, found " + std::to_string(times)};
  if (const int64_t runs = state_->session.runs(step); runs > INT32_MAX - int64_t{times})
    return io::Error{"step '" + step + "' has run " + std::to_string(runs) + " times; it cannot run " +
                     std::to_string(times) + " times more, as its counter ends at 2^31 - 1"};
  const auto frozen = state_->frozen.find(step);
  return guarded([&]() -> io::Result<void> {
    for (int k = 0; k < times; ++k) {
      reference::Frozen record;
      auto result = state_->session.run(step, {.frozen = frozen == state_->frozen.end() ? nullptr : &frozen->second,
                                               .record = &record,
                                               .float32 = state_->float32});
      if (const auto* error = std::get_if<reference::EvalError>(&result)) return io::Error{error->message};
      state_->results[step] = std::move(std::get<reference::StepResult>(result));
      state_->recorded[step] = std::move(record);
    }
    return {};
  });
}

io::Result<void> ReferenceProgram::set_runs(const std::string& step, int64_t runs) {
  if (!state_) return kMovedFrom;
  if (auto problem = state_->unknown_step(step)) return *problem;
  if (runs < 0 || runs > INT32_MAX) return io::Error{"a step cannot have run " + std::to_string(runs) + " times"};
  state_->session.set_runs(step, runs);
  return {};
}

io::Result<io::Array> ReferenceProgram::output(const std::string& step, const std::string& name) {
  if (!state_) return kMovedFrom;
  if (auto problem = state_->unknown_step(step)) return *problem;
  const auto result = state_->results.find(step);
  if (result == state_->results.end()) return io::Error{"step '" + step + "' has not run yet"};
  const auto it = result->second.outputs.find(name);
  if (it == result->second.outputs.end()) return io::Error{"step '" + step + "' has no output '" + name + "'"};
  return state_->seen("output '" + step + "." + name + "'", it->second);
}

io::Result<io::Array> ReferenceProgram::leaf(const std::string& name) {
  if (!state_) return kMovedFrom;
  if (!state_->graph.leaf_index(name)) return state_->no_leaf(name);
  reference::Session& session = state_->session;
  return guarded([&]() -> io::Result<io::Array> {
    if (auto problem = session.settle(name)) return io::Error{*problem};
    return state_->seen("leaf '" + name + "'", session.leaf(name));
  });
}

io::Result<void> ReferenceProgram::freeze(const std::string& step, const std::vector<std::vector<io::Array>>& rasters) {
  if (!state_) return kMovedFrom;
  if (auto problem = state_->unknown_step(step)) return *problem;
  reference::Frozen frozen;
  for (const auto& raster : rasters) {
    const std::string which = "raster " + std::to_string(frozen.rasters.size());
    frozen.rasters.emplace_back();
    for (const io::Array& a : raster) {
      if (!a.consistent() || a.kind != io::ElementKind::Int32 || a.components != 1)
        return io::Error{which + ": faces and tags are arrays of one int32 an element, whose extents and bytes agree"};
      if (const auto numbers = a.as<int32_t>(); std::ranges::any_of(numbers, [](int32_t n) { return n < -1; }))
        return io::Error{which + ": faces and tags are at least 0, or -1 for none, found " +
                         std::to_string(std::ranges::min(numbers))};
      frozen.rasters.back().push_back(to_image(a, ir::kInt));
    }
  }
  if (rasters.empty())
    state_->frozen.erase(step);
  else
    state_->frozen[step] = std::move(frozen);
  return {};
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
