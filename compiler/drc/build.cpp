// SPDX-License-Identifier: Apache-2.0
// `drc build`: one product for each --emit. A product is a row of the table below: a name, the end of its file's name,
// and a function from the program to its content.
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <iterator>
#include <memory>
#include <utility>

#ifdef DR_MIMALLOC
#include <mimalloc.h>
#endif

#include "compiler/backend/compile.h"
#include "compiler/backend/plan/show.h"
#include "compiler/backend/report.h"
#include "compiler/backend/schedule/graphviz.h"
#include "compiler/backend/schedule/text.h"
#include "compiler/backend/spirv/spirv.h"
#include "compiler/drc/bundle_cache.h"
#include "compiler/drc/command.h"
#include "compiler/drc/input.h"
#include "compiler/drc/output.h"
#include "compiler/drc/phase_times.h"
#include "compiler/driver/driver.h"
#include "compiler/ir/print.h"
#include "dsl/diagnostic/diagnostic.h"

namespace dr::drc {
namespace {

// The program on its way. A stage that is missing has been told of.
class Stages {
 public:
  Stages(const BuildOptions& options, PhaseTimes& times) : options_(options), times_(times) {}

  const BuildOptions& options() const { return options_; }
  const driver::Compilation& program() const { return *program_; }
  // Whether the program was told something, an error or a warning.
  bool has_messages() const { return !program_->diagnostics().all().empty(); }

  const ir::Graph* lowered() {
    if (lowered_) return lowered_;
    lowered_ = ask([](driver::Compilation& program) { return program.lowered(); });
    const double parse = program_ ? program_->parse_milliseconds() : 0;
    times_.add("parse", parse);
    times_.add("check and lower", times_.lap() - parse);
    return lowered_;
  }
  // After the passes: those of --passes, or all that are needed before code is made.
  const ir::Graph* differentiated() {
    if (!lowered()) return nullptr;
    return ask([](driver::Compilation& program) { return program.differentiated(); });
  }
  const target::Profile* profile() {
    return ask([](driver::Compilation& program) { return program.profile(); });
  }
  // Schedule, shaders and bundle for the profile.
  const backend::Compiled* compiled() {
    if (!differentiated()) return nullptr;
    compiled_ = ask([](driver::Compilation& program) { return program.compiled(); });
    if (compiled_) scheduled_ = compiled_->joined ? &*compiled_->joined : differentiated();
    return compiled_;
  }
  // What the schedule of compiled() is of.
  const ir::Graph& scheduled() const { return *scheduled_; }
  // Null where no shader was asked for.
  const backend::AssembleTimes* assemble_times() const { return compiled_ ? &compiled_->times : nullptr; }

  // Whether the passes that are named are known; tells of the first that is not. What --stop-after leaves is the
  // product: a graph after a pass over graphs, a schedule after one over schedules, a bundle's commands after others.
  bool find_passes(std::vector<std::string>& emit) const {
    const std::vector<std::string> graphs = driver::graph_pass_names();
    for (const std::string& name : options_.passes.value_or(std::vector<std::string>{}))
      if (std::ranges::find(graphs, name) == graphs.end()) return unknown_pass(name, graphs);
    if (options_.stop_after.empty()) return true;
    std::vector<std::string> all = graphs;
    std::ranges::copy(driver::schedule_pass_names(), std::back_inserter(all));
    const size_t before_bundles = all.size();
    std::ranges::copy(driver::bundle_pass_names(), std::back_inserter(all));
    const auto found = std::ranges::find(all, options_.stop_after);
    if (found == all.end()) return unknown_pass(options_.stop_after, all);
    const auto place = static_cast<size_t>(found - all.begin());
    emit = {place < graphs.size() ? "grad-ir" : place < before_bundles ? "schedule" : "commands"};
    return true;
  }

 private:
  static bool unknown_pass(const std::string& name, const std::vector<std::string>& known) {
    const auto nearest = dsl::nearest_name(name, known);
    print_error("unknown pass '" + name + "'" + (nearest ? ", did you mean '" + *nearest + "'?" : ""));
    return false;
  }

  // --time-passes and --dump-ir.
  void show_pass(std::string_view name, const std::function<std::string()>& text, double milliseconds) {
    times_.add(name, milliseconds);
    times_.add("verify", times_.lap() - milliseconds);  // what is done between passes
    if (!options_.dump_ir || (!options_.dump_ir->empty() && *options_.dump_ir != name)) return;
    std::fprintf(stderr, "// after %s\n%s", std::string(name).c_str(), text().c_str());
    times_.end("print");
  }

  bool open() {
    if (is_open_) return program_ != nullptr;
    is_open_ = true;
    driver::Hooks hooks;
    hooks.verify_each = options_.verify_each;
    hooks.passes = options_.passes;
    hooks.stop_after = options_.stop_after;
    hooks.break_after = options_.break_after;
    hooks.after = [this](std::string_view name, const std::function<std::string()>& text, double milliseconds) {
      show_pass(name, text, milliseconds);
    };
    times_.end("start");
    program_ = open_program(options_.input, std::move(hooks));
    times_.end("read");
    return program_ != nullptr;
  }

  template <typename Stage>
  auto ask(const Stage& stage) -> decltype(stage(std::declval<driver::Compilation&>())) {
    if (!open()) return nullptr;
    const auto result = stage(*program_);
    if (has_messages() && !std::exchange(told_messages_, true)) report(program_->diagnostics(), program_->sources());
    if (program_->error() && !std::exchange(told_error_, true)) tell_error(*program_);
    return result;
  }

  const BuildOptions& options_;
  PhaseTimes& times_;
  std::unique_ptr<driver::Compilation> program_;
  const ir::Graph* lowered_ = nullptr;
  const backend::Compiled* compiled_ = nullptr;
  const ir::Graph* scheduled_ = nullptr;
  bool is_open_ = false, told_messages_ = false, told_error_ = false;
};

struct Product {
  std::string_view name;
  std::string_view extension;
  std::optional<std::string> (*make)(Stages&);
};

std::optional<std::string> make_ast(Stages& stages) { return load_tree(stages.options().input); }

// As lowered, or after --passes.
std::optional<std::string> make_ir(Stages& stages) {
  const ir::Graph* graph = stages.options().passes ? stages.differentiated() : stages.lowered();
  return graph ? std::optional(ir::print(*graph)) : std::nullopt;
}

std::optional<std::string> make_grad_ir(Stages& stages) {
  const ir::Graph* graph = stages.differentiated();
  return graph ? std::optional(ir::print(*graph)) : std::nullopt;
}

std::optional<std::string> make_schedule(Stages& stages) {
  const backend::Compiled* compiled = stages.compiled();
  return compiled ? std::optional(backend::print_whole(stages.scheduled(), compiled->schedule)) : std::nullopt;
}

std::optional<std::string> make_glsl(Stages& stages) {
  const backend::Compiled* compiled = stages.compiled();
  if (!compiled) return std::nullopt;
  std::string out;
  for (const backend::GlslShader& shader : compiled->glsl) {
    out += "// ---- ";
    for (const std::string& name : shader.names) out += (&name == shader.names.data() ? "" : ", ") + name;
    out += "\n" + shader.source + "\n";
  }
  return out;
}

std::optional<std::string> make_spirv(Stages& stages) {
  const backend::Compiled* compiled = stages.compiled();
  if (!compiled) return std::nullopt;
  std::string out;
  for (const auto& shader : compiled->bundle.shaders)
    out += "; ---- " + shader->name + "\n" + backend::disassemble(shader->spirv) + "\n";
  return out;
}

std::optional<std::string> make_graphviz(Stages& stages) {
  const backend::Compiled* compiled = stages.compiled();
  return compiled ? std::optional(backend::print_graphviz(stages.scheduled(), compiled->schedule)) : std::nullopt;
}

// As `drc inspect` shows them.
std::optional<std::string> make_commands(Stages& stages) {
  const backend::Compiled* compiled = stages.compiled();
  return compiled ? std::optional(backend::show(compiled->bundle)) : std::nullopt;
}

std::optional<std::string> make_bundle(Stages& stages) {
  const BundleCache cache(stages.options());
  if (auto found = cache.find()) return found;
  const backend::Compiled* compiled = stages.compiled();
  if (!compiled) return std::nullopt;
  const std::vector<uint8_t> bytes = bundle::write(compiled->bundle);
  std::string out(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  if (!stages.has_messages()) cache.store(out, stages.program().sources());
  return out;
}

// The report on stdout, or on stderr where stdout has a product.
bool write_report(Stages& stages) {
  const BuildOptions& options = stages.options();
  ir::SymbolValues symbols;
  for (const std::string& text : options.symbols) {
    const auto parts = split_assignment(text, "--symbol");
    if (!parts) return false;
    const auto value = ir::Dim::parse(parts->second);
    if (!value || !value->is_constant() || value->constant() < 1 || value->constant() >= int64_t{1} << 31) {
      print_error("the value of the symbol '" + parts->first + "' should be a number from 1 to 2^31 - 1, found '" +
                  parts->second + "'");
      return false;
    }
    symbols[parts->first] = value->constant();
  }
  const backend::Compiled* compiled = stages.compiled();
  if (!compiled) return false;
  const auto report =
      backend::report(stages.scheduled(), *compiled, *stages.profile(), symbols, stages.program().left_out());
  if (const auto* problem = std::get_if<std::string>(&report)) return print_error(*problem), false;
  const auto& numbers = std::get<backend::Report>(report);
  const std::string text = options.report == "json" ? backend::print_json(numbers) : backend::print(numbers);
  if (options.emit.empty() || options.output != "-") return write_product("-", text);
  std::fputs(text.c_str(), stderr);
  return true;
}

constexpr Product kProducts[] = {
    {"ast", ".ast", make_ast},
    {"ir", ".ir", make_ir},
    {"grad-ir", ".grad.ir", make_grad_ir},
    {"schedule", ".schedule", make_schedule},
    {"graphviz", ".dot", make_graphviz},
    {"commands", ".commands", make_commands},
    {"glsl", ".glsl", make_glsl},
    {"spirv", ".spvasm", make_spirv},
    {"bundle", ".drb", make_bundle},
};

}  // namespace

std::vector<std::string> product_names() {
  std::vector<std::string> names;
  for (const Product& product : kProducts) names.emplace_back(product.name);
  return names;
}

namespace {

// The work of shaders runs on all cores: each part has its share of the time that all of it took.
void split_assembling(const backend::AssembleTimes& parts, PhaseTimes& times) {
  const double sum = parts.cache + parts.glslang + parts.inlining + parts.validation, all = times.take("assemble");
  const double scale = sum > 0 ? std::min(1.0, all / sum) : 0;
  times.add("assemble: cache", parts.cache * scale);
  times.add("assemble: glslang", parts.glslang * scale);
  times.add("assemble: inline", parts.inlining * scale);
  times.add("assemble: validate", parts.validation * scale);
  times.add("assemble: wait", all - sum * scale);
}

int build(const BuildOptions& options, PhaseTimes& times) {
  Stages stages(options, times);
  std::vector<std::string> emit = options.emit;
  if (!stages.find_passes(emit)) return kBadUsage;
  const bool several = emit.size() > 1;
  if (several && !std::filesystem::is_directory(options.output)) {
    print_error("expected a folder after -o for several products, found '" + options.output + "'");
    return kBadUsage;
  }
  for (const std::string& name : emit) {
    const auto product = std::ranges::find(kProducts, name, &Product::name);
    const auto content = product->make(stages);
    times.end("make " + name);
    if (!content) return kUserError;
    std::string file = options.output;
    if (several || (file != "-" && std::filesystem::is_directory(file))) {
      const std::string stem =
          options.input.file == "-" ? "stdin" : std::filesystem::path(options.input.file).stem().string();
      file = (std::filesystem::path(file) / (stem + std::string(product->extension))).string();
    }
    const bool written = write_product(file, *content);
    times.end("write " + name);
    if (!written) return kUserError;
  }
  if (!options.report.empty() && !write_report(stages)) return kUserError;
  times.end("report");
  if (const backend::AssembleTimes* parts = stages.assemble_times()) split_assembling(*parts, times);
  return kOk;
}

// What one phase or shader gives back the next one takes: to hand it to the system in between, page by page, is a tenth
// of the time.
void keep_freed_memory() {
#if defined(DR_MIMALLOC) && MI_MALLOC_VERSION >= 210
  mi_option_set(mi_option_purge_delay, -1);
#elif defined(DR_MIMALLOC)
  mi_option_set(mi_option_allow_decommit, 0);
#endif
}

}  // namespace

int build(const BuildOptions& options) {
  keep_freed_memory();
  PhaseTimes times;
  const int code = build(options, times);
  times.end("clean up");
  if (options.time_passes) std::fputs(times.text().c_str(), stderr);
  return code;
}

}  // namespace dr::drc
