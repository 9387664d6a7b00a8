// SPDX-License-Identifier: Apache-2.0
// `drc build`: one product for each --emit. A product is a row of the table below: a name, the end of its file's name,
// and a function from the program to its content.
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <span>

#include "compiler/backend/compile.h"
#include "compiler/backend/report.h"
#include "compiler/backend/schedule/graphviz.h"
#include "compiler/backend/skips.h"
#include "compiler/backend/spirv/shader_cache.h"
#include "compiler/backend/spirv/spirv.h"
#include "compiler/drc/bundle_cache.h"
#include "compiler/drc/command.h"
#include "compiler/drc/input.h"
#include "compiler/drc/output.h"
#include "compiler/ir/print.h"
#include "compiler/passes/passes.h"
#include "dsl/diagnostic.h"

namespace dr::drc {
namespace {

// The program on its way, each stage made when it is first asked for. A stage that is missing has been reported.
class Stages {
 public:
  explicit Stages(const BuildOptions& options) : options_(options) {}

  const BuildOptions& options() const { return options_; }
  const dsl::SourceManager& sources() const { return sources_; }
  // Of the passes that ran.
  const passes::Skips::LeftOut& left_out() const { return left_out_; }
  // Whether the program was told something, an error or a warning.
  bool has_messages() const { return has_messages_; }

  const ir::Graph* lowered() {
    if (!graph_tried_ && profile()) {
      InputOptions input = options_.input;
      std::vector<std::string> defines;
      for (const auto& [name, value] : backend::skip_defines(options_.ablate, *profile()))
        defines.push_back(name + "=" + value);
      input.defines.insert(input.defines.begin(), defines.begin(), defines.end());  // the last one counts
      graph_ = load_graph(input, sources_, &has_messages_);
    }
    graph_tried_ = true;
    return graph_ ? &*graph_ : nullptr;
  }

  // After the passes: those of --passes, or all that are needed before code is made.
  const ir::Graph* differentiated() {
    if (result_) return &*result_;
    if (!lowered()) return nullptr;
    std::vector<passes::Pass> chosen(passes::default_passes().begin(), passes::default_passes().end());
    if (options_.passes) chosen = passes_;
    passes::PipelineOptions pipeline;
    pipeline.verify_each = options_.verify_each;
    pipeline.skips = backend::pass_skips(options_.ablate);
    pipeline.skips.left_out = &left_out_;
    pipeline.after = [&](std::string_view name, const ir::Graph& graph, double milliseconds) {
      const std::string pass(name);
      if (options_.time_passes) std::fprintf(stderr, "%s: %.3f ms\n", pass.c_str(), milliseconds);
      if (!options_.dump_ir || (!options_.dump_ir->empty() && *options_.dump_ir != name)) return;
      std::fprintf(stderr, "// after %s\n%s", pass.c_str(), ir::print(graph).c_str());
    };
    result_ = passes::run_passes(*graph_, chosen, pipeline);
    return &*result_;
  }

  const target::Profile* profile() {
    if (profile_) return &*profile_;
    auto loaded = target::load_profile(options_.profile);
    if (const auto* problem = std::get_if<std::string>(&loaded)) {
      print_error(*problem);
      return nullptr;
    }
    profile_ = std::get<target::Profile>(std::move(loaded));
    return &*profile_;
  }

  // Schedule, shaders and bundle for the profile.
  const backend::Compiled* compiled() {
    if (compiled_) return &*compiled_;
    const ir::Graph* graph = differentiated();
    if (!graph) return nullptr;
    if (!profile()) return nullptr;
    auto options = backend::compile_options(options_.lower, options_.raster, options_.pack, options_.ablate,
                                            options_.scatter, options_.float_profile);
    if (const auto* problem = std::get_if<std::string>(&options)) {
      print_error(*problem);
      return nullptr;
    }
    std::get<backend::CompileOptions>(options).lines = backend::SourceLines(*graph, sources_);
    if (options_.cache) std::get<backend::CompileOptions>(options).cache_folder = backend::default_cache_folder();
    auto result = backend::compile(*graph, *profile_, std::get<backend::CompileOptions>(options));
    if (const auto* problem = std::get_if<std::string>(&result)) {
      print_error(*problem);
      return nullptr;
    }
    compiled_ = std::move(std::get<backend::Compiled>(result));
    return &*compiled_;
  }

  // The passes that --passes names; false after a message.
  bool find_passes() {
    if (!options_.passes) return true;
    std::vector<std::string> known;
    for (const passes::Pass& pass : passes::default_passes()) known.emplace_back(pass.name);
    for (const std::string& name : *options_.passes) {
      const auto found = std::ranges::find(known, name);
      if (found == known.end()) {
        const auto nearest = dsl::nearest_name(name, known);
        print_error("unknown pass '" + name + "'" + (nearest ? ", did you mean '" + *nearest + "'?" : ""));
        return false;
      }
      passes_.push_back(passes::default_passes()[static_cast<size_t>(found - known.begin())]);
    }
    return true;
  }

 private:
  const BuildOptions& options_;
  dsl::SourceManager sources_;
  std::optional<ir::Graph> graph_, result_;
  std::optional<target::Profile> profile_;
  std::optional<backend::Compiled> compiled_;
  std::vector<passes::Pass> passes_;
  passes::Skips::LeftOut left_out_;
  bool graph_tried_ = false;
  bool has_messages_ = false;
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
  return compiled ? std::optional(backend::print(*stages.differentiated(), compiled->schedule)) : std::nullopt;
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
  return compiled ? std::optional(backend::print_graphviz(*stages.differentiated(), compiled->schedule)) : std::nullopt;
}

std::optional<std::string> make_bundle(Stages& stages) {
  const BundleCache cache(stages.options());
  if (auto found = cache.find()) return found;
  const backend::Compiled* compiled = stages.compiled();
  if (!compiled) return std::nullopt;
  const std::vector<uint8_t> bytes = bundle::write(compiled->bundle);
  std::string out(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  if (!stages.has_messages()) cache.store(out, stages.sources());
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
      backend::report(*stages.differentiated(), *compiled, *stages.profile(), symbols, stages.left_out());
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

int build(const BuildOptions& options) {
  Stages stages(options);
  if (!stages.find_passes()) return kBadUsage;
  const bool several = options.emit.size() > 1;
  if (several && !std::filesystem::is_directory(options.output)) {
    print_error("expected a folder after -o for several products, found '" + options.output + "'");
    return kBadUsage;
  }
  for (const std::string& name : options.emit) {
    const auto product = std::ranges::find(kProducts, name, &Product::name);
    const auto content = product->make(stages);
    if (!content) return kUserError;
    std::string file = options.output;
    if (several || (file != "-" && std::filesystem::is_directory(file))) {
      const std::string stem =
          options.input.file == "-" ? "stdin" : std::filesystem::path(options.input.file).stem().string();
      file = (std::filesystem::path(file) / (stem + std::string(product->extension))).string();
    }
    if (!write_product(file, *content)) return kUserError;
  }
  if (!options.report.empty() && !write_report(stages)) return kUserError;
  return kOk;
}

}  // namespace dr::drc
