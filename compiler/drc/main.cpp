// SPDX-License-Identifier: Apache-2.0
// drc: options in, library calls, exit code out.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cctype>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <map>
#include <new>
#include <optional>
#include <set>

#include "compiler/backend/skips.h"
#include "compiler/drc/command.h"
#include "compiler/drc/messages.h"
#include "dsl/syntax/parser.h"
#include "version_generated.h"

namespace {

using namespace dr::drc;
namespace backend = dr::backend;

void add_modules(CLI::App& command, InputOptions& input) {
  command.add_option("-I", input.compile.include_dirs, "Folder to look for imported modules in")
      ->allow_extra_args(false)
      ->type_name("DIR");
  command.add_option("-D", input.defines, "Give a const of the program another value")
      ->allow_extra_args(false)
      ->type_name("NAME=VALUE");
}

void add_input(CLI::App& command, InputOptions& input) {
  command.add_option("file", input.file, "Program (.dr), graph (.ir), schedule (.schedule), or - for stdin")
      ->required();
  add_modules(command, input);
  command.add_flag("--plain-gradients", input.compile.plain_gradients,
                   "Differentiate functions that have a @vjp by their own text");
}

void add_choices(CLI::App& command, dr::driver::Options& options) {
  for (const dr::driver::Choice& choice : dr::driver::choices()) {
    std::string text = choice.text;
    text[0] = static_cast<char>(std::toupper(static_cast<unsigned char>(text[0])));
    CLI::Option* option = command.add_option("--" + choice.name, options.*choice.value, text)->capture_default_str();
    if (!choice.words.empty()) option->check(CLI::IsMember(choice.words));
  }
}

void add_diagnostics(CLI::App& command, std::string& format) {
  command.add_option("--diagnostics", format, "How messages are written on stderr")
      ->capture_default_str()
      ->check(CLI::IsMember({"text", "json"}));
}

// An internal error aborts with its message on stderr; scripts see it as an exit code.
void on_abort(int) { std::_Exit(kInternalError); }

// Where mimalloc finds no memory it would abort without a word, before main() too.
void on_allocator_error(int error, void*) {
  if (error != ENOMEM) return;
  std::fputs("error: this machine has not enough memory for the program and its data\n", stderr);
  std::_Exit(kUserError);
}

}  // namespace

// mimalloc's, where it is linked.
extern "C" [[gnu::weak]] void mi_register_error(void (*handler)(int, void*), void* argument);

namespace {
[[gnu::constructor(101)]] void listen_to_allocator() {
  if (mi_register_error != nullptr) mi_register_error(on_allocator_error, nullptr);
}
}  // namespace

namespace {

// The command line: what it says goes into the options of the command that it names.
class CommandLine {
 public:
  CommandLine() : app_("drc compiles differentiable-rendering programs.", "drc") {
    app_.set_version_flag("--version", std::string("drc ") + dr::version());
    app_.require_subcommand(1);
    app_.footer("Exit codes: 0 ok, 1 error in the input, 2 bad usage, 3 internal error.");
    check_command_ = command("check", "Say what is wrong with a program");
    add_input(*check_command_, check_options_);
    add_diagnostics(*check_command_, diagnostics_);
    add_build();
    add_inspect();
    add_eval();
    add_explain_grad();
    add_fmt();
    add_doc();
    add_lsp();
  }

  // The exit code where there is nothing to run: help was asked for, or what is written makes no sense.
  std::optional<int> parse(int argc, char** argv) {
    // CLI11 would only say that a command is missing.
    std::vector<std::string> commands;
    for (const CLI::App* each : app_.get_subcommands({})) commands.push_back(each->get_name());
    if (argc > 1 && argv[1][0] != '-' && std::ranges::find(commands, argv[1]) == commands.end()) {
      const auto nearest = dr::dsl::nearest_name(argv[1], commands);
      std::fprintf(stderr, "there is no command '%s'%s (see drc --help)\n", argv[1],
                   nearest ? (", did you mean '" + *nearest + "'?").c_str() : "");
      return kBadUsage;
    }

    try {
      app_.parse(argc, argv);
      for (const CLI::App* each : app_.get_subcommands()) must_differ(*each);
    } catch (const CLI::ParseError& error) {
      const bool asked = error.get_exit_code() == 0;
      app_.exit(error);
      return asked ? kOk : kBadUsage;
    }
    return finish();
  }

  int run() {
    if (as_json()) collect_messages();
    int code = kOk;
    if (check_command_->parsed()) code = check(check_options_);
    if (build_command_->parsed()) code = build(build_options_);
    if (inspect_command_->parsed()) code = inspect(inspect_options_);
    if (eval_command_->parsed()) code = eval(eval_options_);
    if (explain_grad_command_->parsed()) code = explain_grad(explain_grad_options_);
    if (fmt_command_->parsed()) code = fmt(fmt_options_);
    if (doc_command_->parsed()) code = doc(doc_options_);
    if (lsp_command_->parsed()) code = lsp(lsp_options_);
    if (explain_command_->parsed()) code = explain(code_to_explain_);
    write_messages();
    // What the system buffered may still find no room.
    if (code != kOk || (std::fflush(stdout) == 0 && std::ferror(stdout) == 0)) return code;
    std::fprintf(stderr, "error: cannot write to stdout\n");
    return kUserError;
  }

 private:
  CLI::App* command(const std::string& name, const std::string& text) { return app_.add_subcommand(name, text); }

  // What is given twice would silently count once.
  static void must_differ(const CLI::App& command) {
    for (const char* name : {"-D", "--known", "--bind", "--symbol"}) {
      const CLI::Option* option = command.get_option_no_throw(name);
      if (option == nullptr) continue;
      std::map<std::string, std::string> values;
      for (const std::string& text : option->results()) {
        const size_t end = std::min(text.find('='), text.size());
        const std::string value = text.substr(std::min(end + 1, text.size()));
        const auto [before, is_new] = values.emplace(text.substr(0, end), value);
        if (!is_new)
          throw CLI::ValidationError(
              name, "'" + before->first + "' is given twice, as '" + before->second + "' and '" + value + "'");
      }
    }
  }

  bool as_json() const { return diagnostics_ == "json"; }

  void add_build() {
    build_options_.input.compile.profile = "lavapipe";
    build_command_ = command("build", "Compile a program");
    add_input(*build_command_, build_options_.input);
    add_diagnostics(*build_command_, diagnostics_);
    CLI::Option* emit_option =
        build_command_
            ->add_option("--emit", build_options_.emit, "What to write, several with commas and a folder for -o")
            ->delimiter(',')
            ->allow_extra_args(false)
            ->check(CLI::IsMember(product_names()))
            ->capture_default_str();
    build_command_->add_option("-o", build_options_.output, "File or folder to write, - for stdout")
        ->capture_default_str()
        ->type_name("FILE");
    build_command_
        ->add_option("--known", build_options_.input.known,
                     "An input's value, which nobody may change later: what it makes zero is left out")
        ->allow_extra_args(false)
        ->type_name("NAME=VALUE");
    add_choices(*build_command_, build_options_.input.compile);
    build_command_
        ->add_option("--ablate", build_options_.input.compile.ablate, "Parts of packing to switch off, with commas")
        ->delimiter(',')
        ->allow_extra_args(false)
        ->check(CLI::IsMember(dr::driver::ablations()));
    build_command_
        ->add_option("--no-skip", no_skip_, "Do work that would be left out, with commas: see docs/explain/skipping.md")
        ->delimiter(',')
        ->allow_extra_args(false)
        ->type_name("ID")
        ->check(CLI::IsMember(std::set<std::string>(std::begin(backend::kSkips), std::end(backend::kSkips))));
    add_passes();
    build_command_->get_option("--stop-after")->excludes(emit_option);
  }

  // How passes are watched, and what is told of them.
  void add_passes() {
    passes_option_ = build_command_->add_option("--passes", passes_, "Run just these passes")
                         ->delimiter(',')
                         ->allow_extra_args(false);
    dump_option_ = build_command_
                       ->add_option("--dump-ir", dump_ir_,
                                    "Print the graph, schedule or bundle to stderr after a pass, or after each")
                       ->expected(0, 1)
                       ->type_name("PASS");
    build_command_->add_flag("--verify-each,!--no-verify-each", build_options_.verify_each,
                             "Verify the graph, schedule or bundle after each pass (the default)");
    build_command_
        ->add_option("--break-after", build_options_.break_after,
                     "Make a pass over schedules or bundles leave an unsound one")
        ->group("");
    CLI::Option* stop_option = build_command_
                                   ->add_option("--stop-after", build_options_.stop_after,
                                                "Run no pass after this one, and write what it leaves")
                                   ->type_name("PASS");
    build_command_->add_flag("--time-passes", build_options_.time_passes,
                             "Print to stderr where the time went, phase by phase");

    report_option_ = build_command_->add_flag(
        "--report{text}", build_options_.report,
        "Say what the program will do: passes, bytes moved, memory, shaders; --report=json for programs");
    stop_option->excludes(build_command_->get_option("--report"));
    build_command_->add_option("--symbol", build_options_.symbols, "Value of a symbol of extents, for the report")
        ->allow_extra_args(false)
        ->type_name("NAME=N");

    build_command_->add_flag("--no-cache", no_cache_, "Neither read nor write the shader cache");
  }

  void add_inspect() {
    inspect_command_ = command("inspect", "Show what is in a bundle");
    inspect_command_->add_option("file", inspect_options_.file, "Bundle (.drb)")->required();
    inspect_command_->add_flag("--json", inspect_options_.json, "As JSON");
    inspect_command_->add_flag("--graph", inspect_options_.graph, "Only the graph it was made from");
  }

  void add_eval() {
    eval_command_ = command("eval", "Run steps on the CPU in float64");
    add_input(*eval_command_, eval_options_.input);
    add_diagnostics(*eval_command_, diagnostics_);
    eval_command_->add_option("--bind", eval_options_.binds, "Data of a leaf: a file, =number or =[list]")
        ->allow_extra_args(false)
        ->type_name("LEAF=SOURCE");
    eval_command_->add_option("--symbol", eval_options_.symbols, "Value of a symbol of extents")
        ->allow_extra_args(false)
        ->type_name("NAME=N");
    eval_command_
        ->add_option("--step", eval_options_.steps,
                     "Step to run and how often; several run in this order; without it all of them, one after another")
        ->allow_extra_args(false)
        ->type_name("NAME[=TIMES]");
    eval_command_->add_option("--steps", eval_options_.times, "How often to run steps that have no number of their own")
        ->check(CLI::Range(int64_t{0}, int64_t{1} << 31))
        ->capture_default_str();
    eval_command_
        ->add_option(
            "--out", eval_options_.out,
            "Folder for the last run's outputs, as STEP.NAME.npy and .png, and for params and states, as NAME.npy")
        ->type_name("DIR");
    eval_command_
        ->add_option("--save", eval_options_.saves,
                     "Write an output, STEP.NAME, or a leaf as .npy, .csv or .png after the run")
        ->allow_extra_args(false)
        ->type_name("NAME=FILE");
    finite_option_ =
        eval_command_
            ->add_option("--check-finite", check_finite_,
                         "Stop at the first NaN or Inf: 'all' that an op makes, or 'results' that one reaches")
            ->expected(0, 1)
            ->check(CLI::IsMember({"all", "results"}));
    eval_command_
        ->add_flag("--check-vjp", eval_options_.check_vjp,
                   "Compare outputs and changed leaves with those of --plain-gradients; they should agree to 1e-6")
        ->excludes("--plain-gradients");
    eval_command_->add_flag("--float32", eval_options_.float32, "Round every op's result to float32");
    eval_command_->add_option("--threads", eval_options_.threads, "Threads to use, 0: all; no result depends on it")
        ->check(CLI::Range(0, 1024))
        ->capture_default_str();
    eval_command_
        ->add_option("--freeze,--raster-from", eval_options_.freeze,
                     "Take faces, tags and pinned values from this folder instead of computing them")
        ->type_name("DIR");
    eval_command_->add_option("--dump-raster", eval_options_.dump, "Folder to write faces, tags and pinned values to")
        ->type_name("DIR");
  }

  void add_explain_grad() {
    explain_grad_command_ = command("explain-grad", "Say where a gradient flows and where it is cut");
    add_input(*explain_grad_command_, explain_grad_options_.input);
    explain_grad_command_->add_option("loss", explain_grad_options_.loss, "What is differentiated: an output or a let")
        ->required();
    explain_grad_command_->add_option("x", explain_grad_options_.target, "With respect to what: a leaf or a let")
        ->required();
  }

  void add_fmt() {
    fmt_command_ = command("fmt", "Print programs in their canonical layout");
    fmt_command_->add_option("file", fmt_options_.files, "Programs (.dr), or - for stdin")->required();
    add_diagnostics(*fmt_command_, diagnostics_);
    CLI::Option* in_place = fmt_command_->add_flag("--in-place", fmt_options_.in_place, "Rewrite the files");
    fmt_command_
        ->add_flag("--check", fmt_options_.check, "Name the files that would change, with exit code 1 if any would")
        ->excludes(in_place);
    fmt_command_
        ->add_option("--edition", fmt_options_.edition,
                     "Carry programs over to this edition of the language: one that names none gets the line")
        ->type_name("NUMBER")
        ->check(CLI::IsMember({dr::dsl::kEdition}));
  }

  void add_doc() {
    explain_command_ = command("explain", "Say what the code of a message means, or list all codes");
    explain_command_->add_option("code", code_to_explain_, "As in error[E0301]");

    doc_command_ = command("doc", "Print the documentation of modules as Markdown");
    doc_command_->add_option("file", doc_options_.files, "Modules or programs (.dr), or - for stdin");
    doc_command_->add_flag("--ops", doc_options_.ops, "The ops that graphs are made of");
    doc_command_->add_flag("--functions", doc_options_.functions, "The names of the language's functions, a line each");
    doc_command_->add_option("-o", doc_options_.output, "File to write, - for stdout")
        ->capture_default_str()
        ->type_name("FILE");
  }

  void add_lsp() {
    lsp_command_ = command("lsp", "Serve an editor: the Language Server Protocol on stdin and stdout");
    add_modules(*lsp_command_, lsp_options_);
    lsp_command_->add_flag("--stdio", stdio_, "Talk on stdin and stdout, as it does without");
  }

  // What options together mean, and which exclude each other.
  std::optional<int> finish() {
    build_options_.input.compile.shader_cache = !no_cache_;
    build_options_.input.compile.ablate.insert(build_options_.input.compile.ablate.end(), no_skip_.begin(),
                                               no_skip_.end());
    if (passes_option_->count() > 0) build_options_.passes = passes_;
    if (finite_option_->count() > 0) eval_options_.check_finite = check_finite_.empty() ? "all" : check_finite_;
    if (report_option_->count() > 0) {
      if (build_options_.report != "text" && build_options_.report != "json") {
        std::fprintf(stderr, "error: --report is text or json, found '%s'\n", build_options_.report.c_str());
        return kBadUsage;
      }
      if (build_command_->get_option("--emit")->count() == 0) build_options_.emit.clear();
    }
    // Nobody who names a bundle wants something else in it.
    if (build_command_->get_option("--emit")->count() == 0 && build_options_.output.ends_with(".drb"))
      build_options_.emit = {"bundle"};
    if (dump_option_->count() > 0) build_options_.dump_ir = dump_ir_;
    if (fmt_options_.in_place && std::ranges::find(fmt_options_.files, "-") != fmt_options_.files.end()) {
      std::fprintf(stderr, "--in-place needs files, - is stdin\n");
      return kBadUsage;
    }
    const bool report_on_stderr =
        report_option_->count() > 0 && !build_options_.emit.empty() && build_options_.output == "-";
    if (as_json() && (dump_option_->count() > 0 || build_options_.time_passes || report_on_stderr)) {
      std::fprintf(stderr,
                   "--dump-ir, --time-passes and --report beside a product print text on stderr, where "
                   "--diagnostics=json is\n");
      return kBadUsage;
    }
    return std::nullopt;
  }

  CLI::App app_;
  std::string diagnostics_ = "text";
  InputOptions check_options_, lsp_options_;
  BuildOptions build_options_;
  InspectOptions inspect_options_;
  EvalOptions eval_options_;
  ExplainGradOptions explain_grad_options_;
  FormatOptions fmt_options_;
  DocOptions doc_options_;
  std::string code_to_explain_;
  CLI::App *check_command_ = nullptr, *build_command_ = nullptr, *inspect_command_ = nullptr, *eval_command_ = nullptr,
           *explain_grad_command_ = nullptr, *fmt_command_ = nullptr, *explain_command_ = nullptr,
           *doc_command_ = nullptr, *lsp_command_ = nullptr;
  const CLI::Option *passes_option_ = nullptr, *dump_option_ = nullptr, *report_option_ = nullptr,
                    *finite_option_ = nullptr;
  std::vector<std::string> passes_, no_skip_;
  std::string dump_ir_, check_finite_ = "all";
  bool no_cache_ = false;
  bool stdio_ = true;  // editors name the road that they talk on, and this is the one there is
};

// The command line's command, and its exit code.
int run(int argc, char** argv) {
  CommandLine line;
  if (const auto code = line.parse(argc, argv)) return *code;
  return line.run();
}

}  // namespace

int main(int argc, char** argv) {
  std::signal(SIGABRT, on_abort);
  try {
    return run(argc, argv);
  } catch (const std::bad_alloc&) {
    print_error("this machine has not enough memory for the program and its data");
    write_messages();
    return kUserError;
  } catch (const std::exception& error) {
    write_messages();
    std::fprintf(stderr, "internal error: %s\n", error.what());
    return kInternalError;
  }
}
