// SPDX-License-Identifier: Apache-2.0
// `drc eval`: runs steps on the reference evaluator, in float64 on the CPU.
#include <charconv>
#include <cstdio>
#include <filesystem>

#include "compiler/drc/command.h"
#include "compiler/drc/input.h"
#include "compiler/passes/passes.h"
#include "compiler/reference/evaluate.h"
#include "dsl/diagnostic.h"
#include "runtime/io/array.h"

namespace dr::drc {
namespace {

std::string number_text(double number) {
  char buffer[40];
  return std::string(buffer, std::to_chars(buffer, buffer + sizeof buffer, number).ptr);
}

// Element by element in a file, plane by plane in the evaluator.
reference::Image to_image(const io::Array& array, const ir::Type& type) {
  reference::Image image = reference::zeros(type, array.width, array.height, array.layers);
  const std::vector<double> values = array.to_doubles();
  const auto components = static_cast<size_t>(type.components());
  const auto count = static_cast<size_t>(image.count());
  for (size_t i = 0; i < count; ++i) {
    for (size_t c = 0; c < components; ++c) image.data[c * count + i] = values[i * components + c];
  }
  return image;
}

io::Array to_array(const reference::Image& image) {
  const auto components = static_cast<size_t>(image.type.components());
  const auto count = static_cast<size_t>(image.count());
  std::vector<double> values(components * count);
  for (size_t i = 0; i < count; ++i) {
    for (size_t c = 0; c < components; ++c) values[i * components + c] = image.data[c * count + i];
  }
  return io::Array::from_doubles(values, static_cast<int>(components), image.width, image.height, image.layers);
}

io::ElementKind kind_of(ir::Scalar scalar) {
  switch (scalar) {
    case ir::Scalar::Bool: return io::ElementKind::Bool;
    case ir::Scalar::Int: return io::ElementKind::Int32;
    case ir::Scalar::Uint: return io::ElementKind::UInt32;
    case ir::Scalar::Float: return io::ElementKind::Float64;
  }
  DR_ICE("a scalar of no kind");
}

std::string value_text(const reference::Image& image) {
  if (image.type.is_scalar())
    return image.type.is_bool() ? (image.data[0] != 0 ? "true" : "false") : number_text(image.data[0]);
  std::string text;
  for (const double component : image.data) text += (text.empty() ? "(" : ", ") + number_text(component);
  return text + ")";
}

bool bind_all(const EvalOptions& options, const ir::Graph& graph, reference::Session& session) {
  for (const std::string& symbol : options.symbols) {
    const auto parts = split_assignment(symbol, "--symbol");
    if (!parts) return false;
    int64_t value = 0;
    const std::string& text = parts->second;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc() || end != text.data() + text.size()) {
      print_error("expected an integer for the symbol '" + parts->first + "', found '" + text + "'");
      return false;
    }
    if (const auto wrong = session.bind_symbol(parts->first, value)) return print_error(*wrong), false;
  }
  for (const std::string& bind : options.binds) {
    const auto parts = split_assignment(bind, "--bind");
    if (!parts) return false;
    const auto leaf = graph.leaf_index(parts->first);
    if (!leaf) {
      std::vector<std::string> known;
      for (const ir::Leaf& other : graph.leaves) known.push_back(other.name);
      const auto nearest = dsl::nearest_name(parts->first, known);
      print_error("the program has no leaf '" + parts->first + "'" +
                  (nearest ? ", did you mean '" + *nearest + "'?" : ""));
      return false;
    }
    const ir::Type type = graph.leaves[*leaf].type;
    auto loaded = io::load_binding(parts->second, type.components());
    if (!loaded) return print_error(loaded.error()), false;
    const auto converted = loaded->converted(kind_of(type.scalar));
    if (!converted) return print_error("the data for '" + parts->first + "': " + converted.error()), false;
    if (const auto wrong = session.bind(parts->first, to_image(*converted, type))) return print_error(*wrong), false;
  }
  if (const auto wrong = session.prepare()) return print_error(*wrong), false;
  return true;
}

// One run after another of one step; its outputs are printed and, of the last run, saved.
bool run_step(const EvalOptions& options, const ir::Step& step, const std::string& prefix,
              reference::Session& session) {
  reference::StepResult last;
  for (int64_t i = 0; i < options.steps; ++i) {
    auto ran = session.run(step.name);
    if (const auto* error = std::get_if<reference::EvalError>(&ran)) return print_error(error->message), false;
    last = std::get<reference::StepResult>(std::move(ran));
    for (const ir::Output& output : step.outputs) {
      const reference::Image& image = last.outputs.at(output.name);
      if (image.count() == 1)
        std::printf("%s%s = %s\n", prefix.c_str(), output.name.c_str(), value_text(image).c_str());
    }
  }
  if (options.out.empty()) return true;
  for (const auto& [name, image] : last.outputs) {
    const auto array =
        to_array(image).converted(image.type.is_float() ? io::ElementKind::Float32 : kind_of(image.type.scalar));
    if (!array) return print_error("the output '" + name + "': " + array.error()), false;
    if (const auto saved = io::save_array(options.out + "/" + prefix + name + ".npy", *array); !saved)
      return print_error(saved.error()), false;
  }
  return true;
}

}  // namespace

int eval(const EvalOptions& options) {
  auto lowered = load_graph(options.input);
  if (!lowered) return kUserError;
  const ir::Graph graph = passes::run_passes(*std::move(lowered), passes::default_passes());
  if (!options.step.empty() && !graph.step_index(options.step)) {
    std::string known;
    for (const ir::Step& step : graph.steps) known += (known.empty() ? "'" : ", '") + step.name + "'";
    print_error("the program has no step '" + options.step + "', only " + (known.empty() ? "none" : known));
    return kUserError;
  }
  if (!options.out.empty()) {
    std::error_code error;
    std::filesystem::create_directories(options.out, error);
    if (error) return print_error("cannot make the folder '" + options.out + "'"), kUserError;
  }
  reference::Session session(graph);
  if (!bind_all(options, graph, session)) return kUserError;
  const bool several = options.step.empty() && graph.steps.size() > 1;
  for (const ir::Step& step : graph.steps) {
    if (!options.step.empty() && step.name != options.step) continue;
    if (!run_step(options, step, several ? step.name + "." : "", session)) return kUserError;
  }
  return kOk;
}

}  // namespace dr::drc
