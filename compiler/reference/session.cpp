// SPDX-License-Identifier: Apache-2.0
// Sessions: leaves, the symbols that their data gives values to, and steps that change them.
#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <utility>

#include "compiler/ir/initial_step.h"
#include "compiler/reference/batch.h"
#include "compiler/reference/evaluation.h"

namespace dr::reference {
namespace {

using ir::Dim;
using ir::SymbolValues;

const char* kind_name(ir::Leaf::Kind kind) {
  switch (kind) {
    case ir::Leaf::Kind::Param: return "param";
    case ir::Leaf::Kind::Input: return "input";
    case ir::Leaf::Kind::State: return "state";
  }
  DR_ICE("unknown kind of leaf");
}

constexpr const char* kAxisNames[] = {"width", "height", "number of layers"};

// The value of the only unbound symbol that makes `dim` equal to `extent`.
struct Solution {
  enum class Kind : uint8_t { Unique, None, NotLinear };
  Kind kind;
  int64_t value = 0;
};

Solution solve(const Dim& dim, const std::string& symbol, int64_t extent, SymbolValues values) {
  const auto at = [&](int64_t x) {
    values[symbol] = x;
    return dim.evaluate(values);
  };
  const auto offset = at(0), next = at(1);
  if (!offset || !next || *next == *offset) return {Solution::Kind::NotLinear};
  const int64_t slope = *next - *offset;
  // Floor divisions and products show at one of these, unless they are made to deceive: the solution is tried as well.
  for (int64_t x : {2, 3, 4, 5, 7, 12, 64, 101, 1000, 4099}) {
    const auto y = at(x);
    if (!y || *y != *offset + slope * x) return {Solution::Kind::NotLinear};
  }
  const int64_t x = (extent - *offset) / slope;
  if (x < 0 || at(x) != extent) return {Solution::Kind::None};
  return {Solution::Kind::Unique, x};
}

using Origins = std::map<std::string, std::string, std::less<>>;

// "'W' is 64 by input 'photo'"
std::string told(const std::string& symbol, const SymbolValues& symbols, const Origins& origins) {
  return "'" + symbol + "' is " + std::to_string(symbols.at(symbol)) + " by " + origins.at(symbol);
}

std::vector<std::string> unbound(const Dim& dim, const SymbolValues& symbols) {
  std::vector<std::string> names = dim.symbols();
  std::erase_if(names, [&](const std::string& name) { return symbols.count(name) != 0; });
  return names;
}

// Compares one extent of a leaf with its data, and gives symbols values where that is possible.
std::optional<std::string> unify(const ir::Leaf& leaf, size_t axis, int64_t extent, SymbolValues& symbols,
                                 Origins& origins) {
  const Dim& dim = axis == 0 ? leaf.extent.w : axis == 1 ? leaf.extent.h : leaf.extent.l;
  const std::string has = describe(leaf) + " has " + kAxisNames[axis] + " " + std::to_string(extent);
  const std::vector<std::string> unknown = unbound(dim, symbols);
  if (unknown.empty()) {
    const auto expected = dim.evaluate(symbols);
    if (expected == extent) return std::nullopt;
    if (const auto symbol = dim.as_symbol()) return told(*symbol, symbols, origins) + ", but " + has;
    if (!expected) return "the extent '" + dim.str() + "' of " + describe(leaf) + " has no value";
    std::string message =
        has + ", expected " + (dim.is_constant() ? "" : dim.str() + " = ") + std::to_string(*expected);
    const char* separator = ", where ";
    for (const std::string& symbol : dim.symbols()) {
      message += separator + told(symbol, symbols, origins);
      separator = " and ";
    }
    return message;
  }
  if (unknown.size() > 1) return std::nullopt;
  const Solution solution = solve(dim, unknown[0], extent, symbols);
  switch (solution.kind) {
    case Solution::Kind::NotLinear: break;
    case Solution::Kind::None: return has + ", but no '" + unknown[0] + "' makes '" + dim.str() + "' equal to that";
    case Solution::Kind::Unique:
      symbols[unknown[0]] = solution.value;
      origins[unknown[0]] = describe(leaf);
      break;
  }
  return std::nullopt;
}

// Whether a number can be one of the type's.
bool representable(double x, ir::Scalar scalar) {
  switch (scalar) {
    case ir::Scalar::Float: return true;
    case ir::Scalar::Bool: return x == 0 || x == 1;
    case ir::Scalar::Int: return x == std::trunc(x) && x >= -2147483648.0 && x <= 2147483647.0;
    case ir::Scalar::Uint: return x == std::trunc(x) && x >= 0 && x <= 4294967295.0;
  }
  DR_ICE("unknown scalar");
}

std::string number(double x) {
  char text[32];
  const auto [end, error] = std::to_chars(text, text + sizeof text, x);
  return std::string(text, end);
}

// Extents of bound leaves against symbols, until nothing new is learned.
std::optional<std::string> unify_all(const ir::Graph& graph, const std::vector<std::optional<Image>>& leaves,
                                     SymbolValues& symbols, Origins& origins) {
  for (size_t known = SIZE_MAX; known != symbols.size();) {
    known = symbols.size();
    for (size_t k = 0; k < leaves.size(); ++k) {
      if (!leaves[k]) continue;
      const int64_t extents[] = {leaves[k]->width, leaves[k]->height, leaves[k]->layers};
      for (size_t axis = 0; axis < 3; ++axis) {
        if (auto error = unify(graph.leaves[k], axis, extents[axis], symbols, origins)) return error;
      }
    }
  }
  return std::nullopt;
}

}  // namespace

std::string describe(const ir::Leaf& leaf) { return std::string(kind_name(leaf.kind)) + " '" + leaf.name + "'"; }

Session::Session(const ir::Graph& graph)
    : graph_(graph), leaves_(graph.leaves.size()), stale_(graph.leaves.size(), false) {}

std::optional<std::string> Session::bind(const std::string& name, Image data) {
  const auto index = graph_.leaf_index(name);
  if (!index) {
    std::string message = "there is no leaf '" + name + "'; there are:";
    for (const ir::Leaf& leaf : graph_.leaves) message += " '" + leaf.name + "'";
    return message;
  }
  const ir::Leaf& leaf = graph_.leaves[*index];
  if (!leaf.table.empty()) return describe(leaf) + " is made from '" + leaf.table_of + "'; bind that instead";
  const auto is_known = [](double x, double initial) { return static_cast<float>(x) == static_cast<float>(initial); };
  if (leaf.is_fixed && !std::ranges::equal(data.data, leaf.initial, is_known))
    return describe(leaf) + " was given another value when the program was compiled";
  return assign(*index, std::move(data));
}

std::optional<std::string> Session::assign(uint32_t index, Image data) {
  const ir::Leaf& leaf = graph_.leaves[index];
  const std::string who = describe(leaf);
  if (data.type.components() != leaf.type.components()) {
    return who + " is " + leaf.type.str() + ", but its data is " + data.type.str();
  }
  const int64_t extents[] = {data.width, data.height, data.layers};
  for (size_t axis = 0; axis < 3; ++axis) {
    if (extents[axis] < 1)
      return who + " has " + kAxisNames[axis] + " " + std::to_string(extents[axis]) + ", at least 1 is expected";
  }
  const size_t expected = components(leaf.type) * size_of(data).count();
  if (data.data.size() != expected) {
    return who + " has " + std::to_string(data.data.size()) + " numbers, its size asks for " + std::to_string(expected);
  }
  const auto wrong =
      std::find_if(data.data.begin(), data.data.end(), [&](double x) { return !representable(x, leaf.type.scalar); });
  if (wrong != data.data.end()) return who + " is " + leaf.type.str() + ", but its data holds " + number(*wrong);
  data.type = leaf.type;

  // Messages name what was bound before, so this leaf is compared last, and alone first.
  ir::SymbolValues symbols = symbols_;
  Origins origins = symbol_origin_;
  for (size_t axis = 0; axis < 3; ++axis) {
    if (auto error = unify(leaf, axis, extents[axis], symbols, origins)) return error;
  }
  auto previous = std::exchange(leaves_[index], std::move(data));
  if (auto error = unify_all(graph_, leaves_, symbols, origins)) {
    leaves_[index] = std::move(previous);
    return error;
  }
  symbols_ = std::move(symbols);
  symbol_origin_ = std::move(origins);
  stale_[index] = true;
  return std::nullopt;
}

std::optional<std::string> Session::bind_symbol(const std::string& symbol, int64_t value) {
  if (value < 1) return "'" + symbol + "' is given as " + std::to_string(value) + ", at least 1 is expected";
  if (symbols_.count(symbol) != 0) {
    if (symbols_.at(symbol) == value) return std::nullopt;
    return told(symbol, symbols_, symbol_origin_) + ", but it is given as " + std::to_string(value);
  }
  ir::SymbolValues symbols = symbols_;
  Origins origins = symbol_origin_;
  symbols[symbol] = value;
  origins[symbol] = "the given value";
  if (auto error = unify_all(graph_, leaves_, symbols, origins)) return error;
  symbols_ = std::move(symbols);
  symbol_origin_ = std::move(origins);
  return std::nullopt;
}

const Image& Session::leaf(const std::string& name) const {
  const auto index = graph_.leaf_index(name);
  DR_ASSERT(index.has_value() && leaves_[*index].has_value());
  return *leaves_[*index];
}

bool Session::has_leaf(const std::string& name) const {
  const auto index = graph_.leaf_index(name);
  return index.has_value() && leaves_[*index].has_value();
}

namespace {

// Marks the leaves that the values are computed from.
void mark_leaves(const ir::Graph& graph, std::span<const ir::ValueId> values, std::vector<bool>& needed) {
  if (values.empty()) return;  // live_ops() would take all steps
  const std::vector<bool> live = ir::live_ops(graph, values);
  for (ir::OpId id : graph.region(graph.root()).ops) {
    const ir::Op& op = graph.op(id);
    if (live[id.index] && op.kind == ir::OpKind::Leaf) needed[*graph.leaf_index(op.attrs.text)] = true;
  }
}

std::vector<ir::ValueId> roots_of(const ir::Step& step) {
  std::vector<ir::ValueId> roots;
  for (const ir::Output& output : step.outputs) roots.push_back(output.value);
  for (const ir::Update& update : step.updates) roots.push_back(update.value);
  return roots;
}

// Whether the step gives the leaf a value without a look at the one that it has.
bool only_writes(const ir::Graph& graph, const ir::Step& step, uint32_t leaf) {
  if (std::ranges::none_of(step.updates, [leaf](const ir::Update& update) { return update.leaf == leaf; }))
    return false;
  std::vector<bool> read(graph.leaves.size());
  mark_leaves(graph, roots_of(step), read);
  return !read[leaf];
}

}  // namespace

std::optional<std::string> Session::prepare(std::span<const std::string> steps) {
  std::vector<bool> needed(leaves_.size(), steps.empty()), read(leaves_.size(), steps.empty());
  for (const std::string& name : steps) {
    const auto index = graph_.step_index(name);
    DR_ASSERT(index.has_value());
    const ir::Step& step = graph_.steps[*index];
    std::vector<bool> reads(leaves_.size());
    mark_leaves(graph_, roots_of(step), reads);
    // What a step before has written needs no data.
    for (size_t k = 0; k < reads.size(); ++k) {
      if (reads[k] && !needed[k]) read[k] = true;
      needed[k] = needed[k] || reads[k];
    }
    for (const ir::Update& update : step.updates) needed[update.leaf] = true;
  }
  return prepare_leaves(needed, read);
}

// The leaves among `read` whose data is computed; what that reads is `read`, too.
std::vector<uint32_t> Session::computed(std::vector<bool>& read) const {
  std::vector<uint32_t> out;
  for (bool more = true; more;) {
    more = false;
    for (uint32_t k = 0; k < leaves_.size(); ++k) {
      const auto step = graph_.step_index(ir::initial_step_of(graph_.leaves[k].name));
      if (!read[k] || leaves_[k] || !step || std::ranges::find(out, k) != out.end()) continue;
      out.push_back(k);
      mark_leaves(graph_, roots_of(graph_.steps[*step]), read);
      more = true;
    }
  }
  return out;
}

void Session::settle() {
  for (size_t k = 0; k < leaves_.size(); ++k) {
    const ir::Leaf& leaf = graph_.leaves[k];
    if (leaf.kind == ir::Leaf::Kind::Input) continue;
    const auto known = [&](const Dim& dim) { return dim.evaluate(symbols_).value_or(0) > 0; };
    // What it is computed from may have no data; then it has no value, and nobody asked for one.
    if (known(leaf.extent.w) && known(leaf.extent.h) && known(leaf.extent.l)) static_cast<void>(settle(leaf.name));
  }
}

std::optional<std::string> Session::settle(const std::string& name) {
  const size_t k = *graph_.leaf_index(name);
  const ir::Leaf& leaf = graph_.leaves[k];
  if (leaves_[k]) return std::nullopt;
  const bool is_computed = graph_.step_index(ir::initial_step_of(leaf.name)).has_value();
  std::vector<bool> only(leaves_.size()), none(leaves_.size());
  only[k] = true;
  const bool begins = !leaf.initial.empty() || leaf.kind == ir::Leaf::Kind::State;
  return prepare_leaves(only, is_computed || !begins ? only : none);
}

std::optional<std::string> Session::prepare_leaves(std::vector<bool> needed, std::vector<bool> read) {
  const std::vector<uint32_t> to_fill = computed(read);
  const auto is_computed = [&](size_t k) { return std::ranges::find(to_fill, k) != to_fill.end(); };
  for (size_t k = 0; k < leaves_.size(); ++k) {
    needed[k] = needed[k] || read[k];
    const ir::Leaf& leaf = graph_.leaves[k];
    if (!needed[k] || leaf.table.empty()) continue;
    const uint32_t faces = *graph_.leaf_index(leaf.table_of);
    needed[faces] = read[faces] = true;
  }
  std::string missing, written;
  size_t unbound_leaves = 0;
  for (size_t k = 0; k < leaves_.size(); ++k) {
    const ir::Leaf& leaf = graph_.leaves[k];
    if (!read[k] || leaves_[k] || !leaf.initial.empty() || leaf.kind == ir::Leaf::Kind::State || !leaf.table.empty() ||
        is_computed(k))
      continue;
    missing += (unbound_leaves++ == 0 ? "" : ", ") + describe(leaf) + " : " + leaf.type.str() + leaf.extent.str();
    for (const ir::Step& step : graph_.steps)
      if (only_writes(graph_, step, static_cast<uint32_t>(k)) && ir::leaf_of_initial_step(step.name).empty())
        written += "; step '" + step.name + "' writes '" + leaf.name + "': run it before";
  }
  if (unbound_leaves > 0)
    return missing + (unbound_leaves == 1 ? " has no data; bind it" : " have no data; bind them") +
           " before the first step" + written;
  if (auto error = make_tables()) return error;
  std::map<size_t, std::array<int64_t, 3>> sizes;  // of those without data
  for (size_t k = 0; k < leaves_.size(); ++k) {
    const ir::Leaf& leaf = graph_.leaves[k];
    if (!needed[k]) continue;
    std::array<int64_t, 3> extents;
    const Dim* const dims[3] = {&leaf.extent.w, &leaf.extent.h, &leaf.extent.l};
    for (size_t axis = 0; axis < 3; ++axis) {
      const std::string of =
          std::string("the ") + kAxisNames[axis] + " '" + dims[axis]->str() + "' of " + describe(leaf);
      const std::vector<std::string> unknown = unbound(*dims[axis], symbols_);
      if (!unknown.empty()) {
        return "'" + unknown[0] + "' has no value: " + (leaves_[k] ? of + " does not determine it" : of + " needs it") +
               "; bind a leaf whose extent is '" + unknown[0] + "', or give the symbol its value";
      }
      const auto extent = dims[axis]->evaluate(symbols_);
      if (!extent || *extent < 1) {
        return of + " is " + (extent ? std::to_string(*extent) : "no number") + ", at least 1 is expected";
      }
      extents[axis] = *extent;
    }
    constexpr int64_t kMost = int64_t{1} << 31;
    const auto [w, h, l] = extents;
    if (w > kMost / h || w * h > kMost / l) return describe(leaf) + " has more than 2^31 elements";
    if (!leaves_[k]) sizes.emplace(k, extents);
  }
  // Nothing is missing: initial values are computed, and then others given.
  for (const uint32_t k : to_fill) {
    if (leaves_[k]) continue;  // for one before
    auto result = run(ir::initial_step_of(graph_.leaves[k].name));
    if (auto* error = std::get_if<EvalError>(&result)) return describe(graph_.leaves[k]) + ": " + error->message;
  }
  for (const auto& [k, extents] : sizes) {
    if (leaves_[k]) continue;
    const ir::Leaf& leaf = graph_.leaves[k];
    Image image = zeros(leaf.type, extents[0], extents[1], extents[2]);
    if (!leaf.initial.empty()) {
      DR_ASSERT(leaf.initial.size() == components(leaf.type) || leaf.initial.size() == 1);
      const size_t count = size_of(image).count();
      for (size_t c = 0; c < components(leaf.type); ++c) {
        std::fill_n(image.data.data() + c * count, count, leaf.initial[leaf.initial.size() == 1 ? 0 : c]);
      }
    }
    leaves_[k] = std::move(image);
  }
  return std::nullopt;
}

std::variant<StepResult, EvalError> Session::run(const std::string& name, const Options& options) {
  const auto index = graph_.step_index(name);
  if (!index) {
    std::string message = "there is no step '" + name + "'; there are:";
    for (const ir::Step& step : graph_.steps) message += " '" + step.name + "'";
    return EvalError{message, {}};
  }
  if (auto error = prepare({&name, 1})) return EvalError{*error, {}};
  const ir::Step& step = graph_.steps[*index];
  auto values = evaluate_values(graph_, roots_of(step),
                                {.symbols = symbols_, .leaves = leaves_, .step_index = runs_[name]}, options);
  if (auto* error = std::get_if<EvalError>(&values)) {
    error->notes.push_back("in run " + std::to_string(runs_[name] + 1) + " of step '" + name + "'");
    return std::move(*error);
  }

  auto& images = std::get<Evaluated>(values).images;
  StepResult result;
  result.warnings = std::move(std::get<Evaluated>(values).warnings);
  for (size_t k = 0; k < step.outputs.size(); ++k) result.outputs[step.outputs[k].name] = std::move(images[k]);
  for (size_t k = 0; k < step.updates.size(); ++k) {
    Image& leaf = *leaves_[step.updates[k].leaf];
    Image& next = images[step.outputs.size() + k];
    DR_ASSERT(size_of(next) == size_of(leaf) && next.type == leaf.type);
    leaf = std::move(next);
  }
  ++runs_[name];
  return result;
}

std::variant<std::vector<Image>, EvalError> Session::evaluate(std::span<const ir::ValueId> values,
                                                              const Options& options) {
  std::vector<bool> needed(leaves_.size());
  mark_leaves(graph_, values, needed);
  if (auto error = prepare_leaves(needed, needed)) return EvalError{*error, {}};
  auto result = evaluate_values(graph_, values, {.symbols = symbols_, .leaves = leaves_, .step_index = 0}, options);
  if (auto* error = std::get_if<EvalError>(&result)) return std::move(*error);
  return std::move(std::get<Evaluated>(result).images);
}

}  // namespace dr::reference
