// SPDX-License-Identifier: Apache-2.0
// `drc eval`: runs steps on the reference evaluator, in float64 on the CPU.
#include <algorithm>
#include <charconv>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <map>
#include <set>

#include "compiler/drc/command.h"
#include "compiler/drc/input.h"
#include "compiler/io/array/array.h"
#include "compiler/io/array/decisions.h"
#include "compiler/io/results.h"
#include "compiler/ir/initial_step.h"
#include "compiler/ir/pins.h"
#include "compiler/ir/symbols.h"
#include "compiler/passes/passes.h"
#include "compiler/reference/arrays.h"
#include "dsl/diagnostic/diagnostic.h"
#include "dsl/source/place.h"

namespace dr::drc {
namespace {

using reference::first_not_finite;
using reference::kind_of;
using reference::to_array;
using reference::to_image;

// The signal that asked for an end. The run at hand comes to its own, and what there is is written.
volatile std::sig_atomic_t stopped_by = 0;

void on_signal(int signal) {
  stopped_by = signal;
  std::signal(signal, SIG_DFL);  // a second one ends the program
}

void catch_signals() {
  for (const int signal : {SIGINT, SIGTERM}) std::signal(signal, on_signal);
}

std::string number_text(double number) {
  if (std::isnan(number)) return "nan";  // whatever its sign
  char buffer[40];
  return std::string(buffer, std::to_chars(buffer, buffer + sizeof buffer, number).ptr);
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
    if (const std::vector<std::string> all = ir::symbols_of(graph); !std::ranges::count(all, parts->first)) {
      std::string names;
      for (const std::string& one : all) names += (names.empty() ? "" : ", ") + one;
      print_error("there is no symbol '" + parts->first + "'" + (names.empty() ? "" : "; there are: " + names));
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
    if (const auto doubt = io::doubt_about(parts->second, *loaded))
      print_warning("leaf '" + parts->first + "': " + *doubt);
    // Floats of any kind go in as they are.
    if (!type.is_float() && loaded->kind != kind_of(type.scalar)) {
      loaded = loaded->converted(kind_of(type.scalar));
      if (!loaded) return print_error("the data for '" + parts->first + "': " + loaded.error()), false;
    }
    if (const auto wrong = session.bind(parts->first, to_image(*loaded, type))) return print_error(*wrong), false;
  }
  return true;
}

// A run of a step, in the order given.
struct Run {
  const ir::Step* step;
  int64_t times;
};

std::optional<std::vector<Run>> runs_of(const EvalOptions& options, const ir::Graph& graph) {
  std::vector<Run> runs;
  if (options.steps.empty()) {
    for (const ir::Step& step : graph.steps)
      if (ir::leaf_of_initial_step(step.name).empty()) runs.push_back({&step, options.times});
    return runs;
  }
  for (const std::string& text : options.steps) {
    const size_t equals = text.find('=');
    const std::string name = text.substr(0, equals);
    const auto index = graph.step_index(name);
    if (!index) {
      std::string known;
      for (const ir::Step& step : graph.steps)
        if (ir::leaf_of_initial_step(step.name).empty()) known += (known.empty() ? "'" : ", '") + step.name + "'";
      print_error("the program has no step '" + name + "', only " + (known.empty() ? "none" : known));
      return std::nullopt;
    }
    int64_t times = options.times;
    if (equals != std::string::npos) {
      const auto [end, error] = std::from_chars(text.data() + equals + 1, text.data() + text.size(), times);
      if (error != std::errc() || end != text.data() + text.size() || times < 0 || times > int64_t{1} << 31) {
        print_error("expected a number of runs after '" + name + "=', found '" + text.substr(equals + 1) + "'");
        return std::nullopt;
      }
    }
    runs.push_back({&graph.steps[*index], times});
  }
  return runs;
}

// Steps in order, with what the options ask for around them.
class Evaluator {
 public:
  Evaluator(const EvalOptions& options, const ir::Graph& graph, const dsl::SourceManager& sources)
      : options_(options), graph_(graph), sources_(sources), session_(graph) {
    for (const auto& [value, name] : ir::pin_names(graph)) pins_[name] = graph.value(value).type;
  }

  bool process(const std::vector<Run>& runs) {
    if (!find_saves(runs) || !bind_all(options_, graph_, session_)) return false;
    std::vector<std::string> names;
    for (const Run& run : runs) names.push_back(run.step->name);
    if (const auto wrong = session_.prepare(names); !names.empty() && wrong) return print_error(*wrong), false;
    const bool ran = run_all(runs);
    // What ran before a mistake is not lost, and a file that cannot be written costs no other one.
    if (!results_.empty()) session_.settle();
    const bool saved = results_.empty() || save_all();
    return save_named() && saved && ran;
  }

  // Of each step's last run.
  const std::map<std::string, reference::StepResult>& results() const { return results_; }
  const reference::Image& leaf(const std::string& name) const { return session_.leaf(name); }

 private:
  // In the form of the compiler's diagnostics, where the source is at hand.
  void report(const char* severity, const reference::EvalError& error) const {
    std::string text;
    if (error.span.valid() && sources_.size() > 0) text = dsl::format_place(sources_, error.span);
    std::fprintf(stderr, "%s%s: %s\n", text.c_str(), severity, error.message.c_str());
    if (!text.empty()) std::fputs(dsl::format_source_line(sources_, error.span).c_str(), stderr);
    for (const std::string& note : error.notes) std::fprintf(stderr, "  %s\n", note.c_str());
  }

  bool run_all(const std::vector<Run>& runs) {
    for (const Run& run : runs)
      for (int64_t k = 0; k < run.times; ++k) {
        if (stopped_by != 0) {
          print_warning("stopped by a signal: writing what there is");
          return true;
        }
        const bool is_first = results_.empty();
        if (!run_once(*run.step)) return false;
        if (is_first) catch_signals();
      }
    return true;
  }

  bool run_once(const ir::Step& step) {
    reference::Options options;
    options.check_finite = options_.check_finite == "all"       ? reference::CheckFinite::All
                           : options_.check_finite == "results" ? reference::CheckFinite::Results
                                                                : reference::CheckFinite::No;
    options.float32 = options_.float32;
    options.threads = options_.threads;
    const int64_t number = runs_done_[step.name]++;
    reference::Frozen frozen, record;
    if (!options_.freeze.empty()) {
      auto loaded = load_frozen(step.name, number);
      if (!loaded) return false;
      frozen = std::move(*loaded);
      options.frozen = &frozen;
    }
    if (!options_.dump.empty()) options.record = &record;
    auto ran = session_.run(step.name, options);
    if (const auto* error = std::get_if<reference::EvalError>(&ran)) return report("error", *error), false;
    reference::StepResult& result = results_[step.name] = std::get<reference::StepResult>(std::move(ran));
    for (const reference::EvalError& warning : result.warnings) {
      if (warned_.insert({warning.span.begin, warning.span.file.index}).second) report("warning", warning);
    }
    for (const ir::Output& output : step.outputs) {
      const reference::Image& image = result.outputs.at(output.name);
      if (image.count() == 1 && !options_.check_vjp)
        std::printf("%s.%s = %s\n", step.name.c_str(), output.name.c_str(), value_text(image).c_str());
    }
    look_for_not_finite(step, result, number + 1);
    return options_.dump.empty() || dump(step.name, number, record);
  }

  // What the run left in params and states, and printed; images of outputs are looked at when a file gets them.
  void look_for_not_finite(const ir::Step& step, const reference::StepResult& result, int64_t run) {
    const std::string when = "run " + std::to_string(run);
    for (const ir::Output& output : step.outputs) {
      const reference::Image& image = result.outputs.at(output.name);
      const std::string name = io::ResultName{step.name, output.name}.str();
      if (image.count() == 1 && first_not_finite(image))
        tell_not_finite(name, "output '" + name + "' is " + value_text(image) + " in " + when);
    }
    for (const ir::Update& update : step.updates) {
      const std::string& name = graph_.leaves[update.leaf].name;
      if (const auto place = first_not_finite(session_.leaf(name)))
        tell_not_finite(
            name, "'" + name + "' has " + io::describe(*place) + " after " + when + " of step '" + step.name + "'");
    }
  }

  // Once for each output of a step and each leaf; what is wrong then stays wrong.
  void tell_not_finite(const std::string& name, const std::string& what) const {
    if (options_.check_vjp || !told_.insert(name).second) return;
    print_warning(what + ": --check-finite stops at the op that makes the first one, with its line");
  }

  std::optional<reference::Frozen> load_frozen(const std::string& step, int64_t number) const {
    std::map<std::string, int> components;
    for (const auto& [name, type] : pins_) components[name] = type.components();
    const auto loaded = io::load_decisions(options_.freeze, step, number, components);
    if (!loaded) return print_error(loaded.error()), std::nullopt;
    reference::Frozen frozen;
    for (const auto& raster : loaded->rasters) {
      auto& images = frozen.rasters.emplace_back();
      for (const io::Array& array : raster) images.push_back(to_image(array, ir::kInt));
    }
    for (const auto& [name, array] : loaded->pins) frozen.pins[name] = to_image(array, pins_.at(name));
    return frozen;
  }

  bool dump(const std::string& step, int64_t number, const reference::Frozen& record) const {
    io::Decisions decisions;
    for (const auto& raster : record.rasters) {
      auto& arrays = decisions.rasters.emplace_back();
      for (const reference::Image& image : raster) {
        auto array = to_array(image);
        if (!array) return print_error("a raster's result: " + array.error()), false;
        arrays.push_back(*std::move(array));
      }
    }
    for (const auto& [name, image] : record.pins) {
      auto array = to_array(image);
      if (!array) return print_error("the pinned value '" + name + "': " + array.error()), false;
      decisions.pins.emplace_back(name, *std::move(array));
    }
    const auto saved = io::save_decisions(options_.dump, step, number, decisions);
    return saved.ok() || (print_error(saved.error()), false);
  }

  static bool told(const io::Result<void>& done) { return done.ok() || (print_error(done.error()), false); }

  // As it was computed: floats in float64.
  std::optional<io::Array> typed(const std::string& name, const reference::Image& image) const {
    if (const auto place = first_not_finite(image)) tell_not_finite(name, "'" + name + "' has " + io::describe(*place));
    auto array = to_array(image);
    if (!array) return print_error("the value '" + name + "': " + array.error()), std::nullopt;
    return *std::move(array);
  }

  // `--out`: outputs of the steps that ran, and params and states, as drun leaves them.
  bool save_all() const {
    if (options_.out.empty()) return true;
    io::ResultsFolder folder(options_.out);
    const auto add = [&](const io::ResultName& name, const reference::Image& image) {
      const auto array = typed(name.str(), image);
      if (array) folder.add(name, *array);
      return array.has_value();
    };
    for (const auto& [step, result] : results_)
      for (const auto& [name, image] : result.outputs)
        if (!add({step, name}, image)) return false;
    for (const ir::Leaf& leaf : graph_.leaves)
      if (leaf.kind != ir::Leaf::Kind::Input && session_.has_leaf(leaf.name) &&
          !add({"", leaf.name}, session_.leaf(leaf.name)))
        return false;
    for (const std::string& warning : folder.warnings()) print_warning(warning);
    return told(folder.finish(false));
  }

  // `--save NAME=FILE`, before anything runs: what is meant, and whether it can be written.
  bool find_saves(const std::vector<Run>& runs) {
    io::ResultNames names;
    std::map<std::string, ir::Type> types;
    for (const ir::Leaf& leaf : graph_.leaves) {
      names.leaves.push_back(leaf.name);
      types[leaf.name] = leaf.type;
    }
    std::set<std::string> listed;
    for (const Run& run : runs) {
      if (run.times == 0 || !listed.insert(run.step->name).second) continue;
      auto& outputs = names.steps.emplace_back(run.step->name, std::vector<std::string>()).second;
      for (const ir::Output& output : run.step->outputs) {
        outputs.push_back(output.name);
        types[io::ResultName{run.step->name, output.name}.str()] = graph_.value(output.value).type;
      }
    }
    if (const auto shared = options_.out.empty() ? std::nullopt : io::shared_name(names))
      return print_error(*shared), false;
    for (const std::string& text : options_.saves) {
      const auto parts = split_assignment(text, "--save");
      if (!parts) return false;
      const auto found = io::find_result(parts->first, names);
      if (!found) return print_error("--save " + text + ": " + found.error()), false;
      const ir::Type& type = types.at(found->str());
      if (!told(io::check_saved(parts->second, kind_of(type.scalar), type.components()))) return false;
      saves_.emplace_back(*found, parts->second);
    }
    return true;
  }

  // Each is written, whatever becomes of the others.
  bool save_named() const {
    bool saved = true;
    for (const auto& [name, file] : saves_) {
      if (!name.step.empty() && !results_.contains(name.step)) {
        print_warning("--save: '" + file + "' is not written, as the step of '" + name.str() + "' has not run");
        continue;
      }
      if (name.step.empty() && !session_.has_leaf(name.name)) {
        print_error("leaf '" + name.name + "' has no value to save: no step that ran needs it");
        saved = false;
        continue;
      }
      const reference::Image& image =
          name.step.empty() ? session_.leaf(name.name) : results_.at(name.step).outputs.at(name.name);
      const auto array = typed(name.str(), image);
      saved = array && told(io::save_array(file, *array)) && saved;
    }
    return saved;
  }

  const EvalOptions& options_;
  const ir::Graph& graph_;
  const dsl::SourceManager& sources_;
  reference::Session session_;
  std::map<std::string, ir::Type> pins_;
  std::map<std::string, int64_t> runs_done_;
  std::map<std::string, reference::StepResult> results_;       // of each step's last run
  std::vector<std::pair<io::ResultName, std::string>> saves_;  // and their files
  std::set<std::pair<uint32_t, uint32_t>> warned_;
  mutable std::set<std::string> told_;  // outputs and leaves with a NaN or Inf
};

constexpr double kVjpTolerance = 1e-6;  // relative L2, as for adjoints near singular points

// The distance of two images over the length of the longer one.
double relative_distance(const reference::Image& a, const reference::Image& b) {
  double difference = 0, length_a = 0, length_b = 0;
  for (size_t i = 0; i < a.data.size(); ++i) {
    difference += (a.data[i] - b.data[i]) * (a.data[i] - b.data[i]);
    length_a += a.data[i] * a.data[i];
    length_b += b.data[i] * b.data[i];
  }
  const double longer = std::max(length_a, length_b);
  return longer == 0 ? 0 : std::sqrt(difference / longer);
}

// `--check-vjp`: every output, and every leaf that changed, with the gradients that functions bring along, and with
// those of their text.
int check_vjp(const EvalOptions& options, const ir::Graph& graph, const dsl::SourceManager& sources,
              const std::vector<Run>& runs) {
  EvalOptions plain_options = options;
  plain_options.input.compile.plain_gradients = true;
  const auto plain_program = load_graph(plain_options.input);
  if (!plain_program) return kUserError;
  const ir::Graph& plain = *plain_program->differentiated();
  const auto plain_runs = runs_of(options, plain);
  Evaluator own(options, graph, sources), text(options, plain, plain_program->sources());
  if (!own.process(runs) || !text.process(*plain_runs)) return kUserError;
  bool differs = false;
  const auto compare = [&](const std::string& name, const reference::Image& a, const reference::Image& b) {
    const double distance = relative_distance(a, b);
    const bool agrees = distance <= kVjpTolerance;  // false for NaN
    differs = differs || !agrees;
    std::printf("%s: %s (relative L2 %.3g)\n", name.c_str(), agrees ? "agrees" : "differs", distance);
  };
  std::set<std::string> changed;
  for (const auto& [step, result] : own.results()) {
    for (const auto& [name, image] : result.outputs)
      compare(step + "." + name, image, text.results().at(step).outputs.at(name));
    for (const ir::Update& update : graph.steps[*graph.step_index(step)].updates)
      changed.insert(graph.leaves[update.leaf].name);
  }
  for (const std::string& name : changed) compare(name, own.leaf(name), text.leaf(name));
  if (differs) print_error("a '@vjp' is not the gradient of its function's text");
  return differs ? kUserError : kOk;
}

}  // namespace

int eval(const EvalOptions& options) {
  // Constants that are folded have the bits of a device, float32.
  InputOptions input = options.input;
  input.compile.ablate.push_back("fold");
  const auto program = load_graph(input);
  if (!program) return kUserError;
  const ir::Graph& graph = *program->differentiated();
  const auto runs = runs_of(options, graph);
  if (!runs) return kUserError;
  if (!options.out.empty())
    if (const auto made = io::make_results_folder(options.out); !made) return print_error(made.error()), kUserError;
  if (options.check_vjp) return check_vjp(options, graph, program->sources(), *runs);
  const bool done = Evaluator(options, graph, program->sources()).process(*runs);
  return !done ? kUserError : stopped_by != 0 ? 128 + stopped_by : kOk;
}

}  // namespace dr::drc
