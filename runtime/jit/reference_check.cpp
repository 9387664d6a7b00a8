// SPDX-License-Identifier: Apache-2.0
#include "runtime/jit/reference_check.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <optional>

#include "compiler/backend/bundle/bundle.h"
#include "compiler/backend/bundle/entries.h"
#include "compiler/backend/bundle/touched.h"
#include "runtime/data/lines.h"
#include "runtime/jit/reference_program.h"

namespace dr::jit {

using io::Array;

namespace {

// Of the larger of a number's own magnitude and the root mean square of its value: what tests allow gradients.
constexpr double kTolerance = 1e-4;
// What float32 alone makes of the program may be so many times larger on a device, which rounds at other places. Of all
// numbers but one in a hundred: a few that float32 decides otherwise say nothing of the others.
constexpr double kOfFloat32 = 16;
constexpr size_t kFew = 100;
// Beyond this a number that float32 alone makes as different is told of.
constexpr double kFarOff = 0.1;
// Pixels that a raster may give to another face.
constexpr double kOtherFaces = 0.01;

bool same(double a, double b) { return a == b || (std::isnan(a) && std::isnan(b)); }

// The largest but for one in a hundred.
double most_but_few(std::vector<double> errors) {
  if (errors.empty()) return 0;
  const auto at = errors.end() - 1 - static_cast<std::ptrdiff_t>(errors.size() / kFew);
  std::ranges::nth_element(errors, at);
  return *at;
}

// The numbers of `found` that are not those of `expected`; `float32`: the same computed in float32, or nothing.
void compare(const Array& found, const std::vector<double>& expected, const std::vector<double>& float32,
             Difference& out) {
  const std::vector<double> numbers = found.to_doubles();
  double squares = 0, worst = -1;
  int64_t finite = 0;
  for (size_t k = 0; k < expected.size(); ++k)
    if (std::isfinite(expected[k])) squares += expected[k] * expected[k], ++finite;
  const double rms = finite > 0 ? std::sqrt(squares / static_cast<double>(finite)) : 0;
  std::vector<double> own(numbers.size(), 0.0);  // what float32 alone makes of each
  for (size_t k = 0; k < float32.size(); ++k)
    if (std::isfinite(float32[k] - expected[k])) own[k] = std::fabs(float32[k] - expected[k]);
  const double rounding = most_but_few(own);
  out.size = static_cast<int64_t>(numbers.size());
  for (size_t k = 0; k < numbers.size(); ++k) {
    if (same(numbers[k], expected[k])) continue;
    if (!float32.empty() && same(numbers[k], float32[k])) continue;
    const double error = std::fabs(numbers[k] - expected[k]);
    if (error <= kTolerance * std::max(rms, std::fabs(expected[k])) + kOfFloat32 * std::max(rounding, own[k])) continue;
    ++out.count;
    const double rank = std::isfinite(error) ? error : HUGE_VAL;
    if (rank <= worst) continue;
    worst = rank;
    const int64_t element = static_cast<int64_t>(k) / found.components;
    out.place = {element % found.width, element / found.width % found.height, element / found.width / found.height,
                 numbers[k]};
    out.expected = expected[k];
    out.share = rank / std::max({rms, std::fabs(expected[k]), 1e-300});
  }
}

// Whether face or tag `part` of a raster is right as far as it goes: the device says that there is a face, not which.
bool says_as_much(const std::vector<Array>& found, const std::vector<Array>& expected, size_t part, size_t element) {
  const size_t face = part / 2 * 2;
  return found[face].as<int32_t>()[element] == bundle::kSomeFace && expected[face].as<int32_t>()[element] >= 0;
}

std::string text_of(double number) {
  char text[32];
  std::snprintf(text, sizeof text, "%.9g", number);
  return text;
}

}  // namespace

struct ReferenceCheck::State {
  struct Value {
    std::string name;
    uint32_t resource;
    bool leaf;
    size_t written;  // the command
  };
  using Leaves = std::vector<std::pair<std::string, Array>>;
  io::Result<Comparison> run(runtime::Program& program, const std::string& name, int64_t runs);
  io::Result<void> run_reference(const Leaves& leaves, const std::string& step, int64_t runs, bool float32);
  io::Result<std::vector<Array>> expected(const std::string& step, const std::vector<Value>& values);
  std::vector<Value> values_of(const bundle::StepT& step) const;
  Difference found_in(const bundle::StepT& step, const std::string& name, uint32_t resource) const;

  bundle::BundleT bundle;
  ReferenceProgram reference;
};

ReferenceCheck::ReferenceCheck(std::unique_ptr<State> state) : state_(std::move(state)) {}
ReferenceCheck::ReferenceCheck(ReferenceCheck&&) noexcept = default;
ReferenceCheck& ReferenceCheck::operator=(ReferenceCheck&&) noexcept = default;
ReferenceCheck::~ReferenceCheck() = default;

io::Result<ReferenceCheck> ReferenceCheck::load(std::span<const uint8_t> bytes) {
  auto bundle = bundle::read(bytes);
  if (const auto* problem = std::get_if<std::string>(&bundle)) return io::Error{*problem};
  auto reference = ReferenceProgram::load(bytes);
  if (!reference) return io::Error{reference.error()};
  return ReferenceCheck(
      std::make_unique<State>(std::move(std::get<bundle::BundleT>(bundle)), std::move(reference).value()));
}

io::Result<void> ReferenceCheck::bind_symbol(const std::string& symbol, int64_t value) {
  return state_->reference.bind_symbol(symbol, value);
}

io::Result<Comparison> ReferenceCheck::run(runtime::Program& program, const std::string& step, int64_t runs) {
  return state_->run(program, step, runs);
}

// Outputs and changed leaves, in the order in which commands of the step write them last.
std::vector<ReferenceCheck::State::Value> ReferenceCheck::State::values_of(const bundle::StepT& step) const {
  std::vector<Value> out;
  for (const auto& output : step.outputs) out.push_back({output->name, output->resource, false, 0});
  for (const uint32_t leaf : step.changes)
    out.push_back({bundle.leaves[leaf]->name, bundle.leaves[leaf]->resource, true, 0});
  for (size_t k = 0; k < step.commands.size(); ++k)
    for (const bundle::Touched& t : bundle::touched_by(*step.commands[k]))
      for (Value& value : out)
        if (t.written && t.resource == value.resource) value.written = k;
  std::ranges::stable_sort(out, {}, &Value::written);
  return out;
}

Difference ReferenceCheck::State::found_in(const bundle::StepT& step, const std::string& name,
                                           uint32_t resource) const {
  Difference out;
  out.value = name;
  for (const auto& command : step.commands) {
    const auto touched = bundle::touched_by(*command);
    if (std::ranges::none_of(touched, [&](const auto& t) { return t.written && t.resource == resource; })) continue;
    out.pass = command->label;
    out.lines.clear();
    for (const bundle::Line& line : command->lines)
      out.lines.push_back(bundle.files[line.file()] + ":" + std::to_string(line.line()));
  }
  return out;
}

io::Result<void> ReferenceCheck::State::run_reference(const Leaves& leaves, const std::string& step, int64_t runs,
                                                      bool float32) {
  for (const auto& [name, data] : leaves)
    if (auto bound = reference.bind(name, data); !bound) return bound;
  if (auto set = reference.set_runs(step, runs); !set) return set;
  reference.round_to_float32(float32);
  return reference.run(step);
}

io::Result<std::vector<Array>> ReferenceCheck::State::expected(const std::string& step,
                                                               const std::vector<Value>& values) {
  std::vector<Array> out;
  for (const Value& value : values) {
    auto array = value.leaf ? reference.leaf(value.name) : reference.output(step, value.name);
    if (!array) return io::Error{array.error()};
    out.push_back(*std::move(array));
  }
  return out;
}

io::Result<Comparison> ReferenceCheck::State::run(runtime::Program& program, const std::string& name, int64_t runs) {
  const auto it = std::ranges::find_if(bundle.steps, [&](const auto& s) { return s->name == name; });
  if (it == bundle.steps.end()) return io::Error{"there is no step '" + name + "'"};
  const bundle::StepT& step = **it;
  Leaves leaves;
  for (const uint32_t index : step.leaves) {
    const bundle::LeafT& leaf = *bundle.leaves[index];
    if (!leaf.table.empty()) continue;
    // One that has no value, yet, is told of by the run.
    if (auto data = program.leaf(leaf.name)) leaves.emplace_back(leaf.name, *std::move(data));
  }
  if (auto ran = program.run(name); !ran) return io::Error{ran.error()};
  auto chosen = program.rasters(name);
  if (!chosen) return io::Error{chosen.error()};

  Comparison out;
  if (auto freed = reference.freeze(name, {}); !freed) return io::Error{freed.error()};
  if (auto ran = run_reference(leaves, name, runs, false); !ran) return io::Error{ran.error()};
  const auto own = reference.rasters(name);
  bool others = false;
  for (size_t k = 0; k < own.size() && k < chosen->size(); ++k)
    for (size_t j = 0; j < own[k].size() && j < (*chosen)[k].size(); ++j) {
      const auto& resources = step.rasters[k]->resources;
      Difference difference = found_in(
          step, std::string(j % 2 == 0 ? "face " : "tag ") + std::to_string(j / 2) + " of raster " + std::to_string(k),
          resources[std::min(j, resources.size() - 1)]);
      const Array& found = (*chosen)[k][j];
      const std::vector<double> numbers = found.to_doubles(), expected_numbers = own[k][j].to_doubles();
      for (size_t e = 0; e < numbers.size(); ++e) {
        if (numbers[e] == expected_numbers[e] || says_as_much((*chosen)[k], own[k], j, e)) continue;
        const auto element = static_cast<int64_t>(e);
        if (difference.count++ == 0) {
          difference.place = {element % found.width, element / found.width % found.height,
                              element / found.width / found.height, numbers[e]};
          difference.expected = expected_numbers[e];
        }
      }
      ++out.values;
      others = others || difference.count > 0;
      difference.size = static_cast<int64_t>(numbers.size());
      if (static_cast<double>(difference.count) > kOtherFaces * static_cast<double>(difference.size) + 1)
        out.differ.push_back(difference);
    }
  if (others) {
    if (auto taken = reference.freeze(name, *chosen); !taken) return io::Error{taken.error()};
    if (auto ran = run_reference(leaves, name, runs, false); !ran) return io::Error{ran.error()};
  }

  const std::vector<Value> values = values_of(step);
  const auto expected_values = expected(name, values);
  if (!expected_values) return io::Error{expected_values.error()};
  std::optional<std::vector<Array>> in_float32;
  for (size_t k = 0; k < values.size(); ++k) {
    const auto found = values[k].leaf ? program.leaf(values[k].name) : program.output(name, values[k].name);
    if (!found) return io::Error{found.error()};
    const std::vector<double> numbers = (*expected_values)[k].to_doubles();
    Difference difference = found_in(step, values[k].name, values[k].resource);
    compare(*found, numbers, {}, difference);
    ++out.values;
    if (difference.count == 0) continue;
    if (!in_float32) {
      // Both decide alike, so that only rounding is between them.
      if (auto taken = reference.freeze(name, *chosen); !taken) return io::Error{taken.error()};
      if (auto ran = run_reference(leaves, name, runs, true); !ran) return io::Error{ran.error()};
      auto rounded = expected(name, values);
      if (!rounded) return io::Error{rounded.error()};
      in_float32 = *std::move(rounded);
    }
    const Difference without = difference;
    difference.count = 0;
    compare(*found, numbers, (*in_float32)[k].to_doubles(), difference);
    if (difference.count > 0)
      out.differ.push_back(difference);
    else if (without.share > kFarOff)
      out.excused.push_back(without);
  }
  return out;
}

std::string describe(const Difference& d) {
  const std::string lines = d.lines.empty() ? "" : "; lines " + runtime::few_of(d.lines);
  return "pass '" + d.pass + "' gives " + text_of(d.place.value) + " for '" + d.value + "' at element (" +
         std::to_string(d.place.x) + ", " + std::to_string(d.place.y) + ", " + std::to_string(d.place.layer) +
         "), the reference " + text_of(d.expected) + "; " + std::to_string(d.count) + " of " + std::to_string(d.size) +
         " numbers differ" + lines;
}

}  // namespace dr::jit
