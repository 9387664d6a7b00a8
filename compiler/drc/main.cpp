// SPDX-License-Identifier: Apache-2.0
// drc: options in, library calls, exit code out.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <new>
#include <set>

#include "compiler/backend/skips.h"
#include "compiler/drc/command.h"
#include "compiler/drc/messages.h"
#include "dsl/parser.h"
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

// The command line's command, and its exit code.
int run(int argc, char** argv) {
  CLI::App app("drc compiles differentiable-rendering programs.", "drc");
  app.set_version_flag("--version", std::string("drc ") + dr::version());
  app.require_subcommand(1);
  app.footer("Exit codes: 0 ok, 1 error in the input, 2 bad usage, 3 internal error.");

  std::string diagnostics = "text";
  InputOptions check_options;
  CLI::App* check_command = app.add_subcommand("check", "Say what is wrong with a program");
  add_input(*check_command, check_options);
  add_diagnostics(*check_command, diagnostics);

  BuildOptions build_options;
  build_options.input.compile.profile = "lavapipe";
  CLI::App* build_command = app.add_subcommand("build", "Compile a program");
  add_input(*build_command, build_options.input);
  add_diagnostics(*build_command, diagnostics);
  CLI::Option* emit_option =
      build_command->add_option("--emit", build_options.emit, "What to write, several with commas and a folder for -o")
          ->delimiter(',')
          ->allow_extra_args(false)
          ->check(CLI::IsMember(product_names()))
          ->capture_default_str();
  build_command->add_option("-o", build_options.output, "File or folder to write, - for stdout")
      ->capture_default_str()
      ->type_name("FILE");
  build_command
      ->add_option("--profile", build_options.input.compile.profile,
                   "Device to build for: a built-in name or a JSON file")
      ->capture_default_str();
  build_command->add_option("--lower", build_options.input.compile.lower, "Where maps run")
      ->capture_default_str()
      ->check(CLI::IsMember({"auto", "fragment", "compute"}));
  build_command->add_option("--raster", build_options.input.compile.raster, "How raster runs")
      ->capture_default_str()
      ->check(CLI::IsMember({"auto", "hardware", "compute"}));
  build_command->add_option("--scatter", build_options.input.compile.scatter, "How scattered values are summed")
      ->capture_default_str()
      ->check(CLI::IsMember({"auto", "exact", "rows", "atomic"}));
  build_command
      ->add_option("--float", build_options.input.compile.float_profile,
                   "Floats: our own functions, the same bits however ops are packed, or the driver's, faster")
      ->capture_default_str()
      ->check(CLI::IsMember({"strict", "native"}));
  build_command->add_option("--pack", build_options.input.compile.pack, "How ops share passes")
      ->capture_default_str()
      ->check(CLI::IsMember({"fused", "naive"}));
  build_command
      ->add_option("--ablate", build_options.input.compile.ablate, "Parts of packing to switch off, with commas")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->check(CLI::IsMember({"substages", "stages", "remat", "cache"}));
  std::vector<std::string> no_skip;
  build_command
      ->add_option("--no-skip", no_skip, "Do work that would be left out, with commas: see docs/explain/skipping.md")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->type_name("ID")
      ->check(CLI::IsMember(std::set<std::string>(std::begin(backend::kSkips), std::end(backend::kSkips))));
  std::vector<std::string> passes;
  const CLI::Option* passes_option =
      build_command->add_option("--passes", passes, "Run just these passes")->delimiter(',')->allow_extra_args(false);
  std::string dump_ir;
  const CLI::Option* dump_option =
      build_command
          ->add_option("--dump-ir", dump_ir,
                       "Print the graph, schedule or bundle to stderr after a pass, or after each")
          ->expected(0, 1)
          ->type_name("PASS");
  build_command->add_flag("--verify-each,!--no-verify-each", build_options.verify_each,
                          "Verify the graph, schedule or bundle after each pass (the default)");
  build_command
      ->add_option("--break-after", build_options.break_after,
                   "Make a pass over schedules or bundles leave an unsound one")
      ->group("");
  CLI::Option* stop_option =
      build_command
          ->add_option("--stop-after", build_options.stop_after, "Run no pass after this one, and write what it leaves")
          ->type_name("PASS")
          ->excludes(emit_option);
  build_command->add_flag("--time-passes", build_options.time_passes,
                          "Print to stderr where the time went, phase by phase");

  const CLI::Option* report_option = build_command->add_flag(
      "--report{text}", build_options.report,
      "Say what the program will do: passes, bytes moved, memory, shaders; --report=json for programs");
  stop_option->excludes(build_command->get_option("--report"));
  build_command->add_option("--symbol", build_options.symbols, "Value of a symbol of extents, for the report")
      ->allow_extra_args(false)
      ->type_name("NAME=N");

  bool no_cache = false;
  build_command->add_flag("--no-cache", no_cache, "Neither read nor write the shader cache");

  InspectOptions inspect_options;
  CLI::App* inspect_command = app.add_subcommand("inspect", "Show what is in a bundle");
  inspect_command->add_option("file", inspect_options.file, "Bundle (.drb)")->required();
  inspect_command->add_flag("--json", inspect_options.json, "As JSON");
  inspect_command->add_flag("--graph", inspect_options.graph, "Only the graph it was made from");

  EvalOptions eval_options;
  CLI::App* eval_command = app.add_subcommand("eval", "Run steps on the CPU in float64");
  add_input(*eval_command, eval_options.input);
  add_diagnostics(*eval_command, diagnostics);
  eval_command->add_option("--bind", eval_options.binds, "Data of a leaf: a file, =number or =[list]")
      ->allow_extra_args(false)
      ->type_name("LEAF=SOURCE");
  eval_command->add_option("--symbol", eval_options.symbols, "Value of a symbol of extents")
      ->allow_extra_args(false)
      ->type_name("NAME=N");
  eval_command
      ->add_option("--step", eval_options.steps,
                   "Step to run and how often; several run in this order; without it all of them, one after another")
      ->allow_extra_args(false)
      ->type_name("NAME[=TIMES]");
  eval_command->add_option("--steps", eval_options.times, "How often to run steps that have no number of their own")
      ->check(CLI::Range(int64_t{0}, int64_t{1} << 31))
      ->capture_default_str();
  eval_command
      ->add_option(
          "--out", eval_options.out,
          "Folder for the last run's outputs, as STEP.NAME.npy and .png, and for params and states, as NAME.npy")
      ->type_name("DIR");
  eval_command
      ->add_option("--save", eval_options.saves,
                   "Write an output, STEP.NAME, or a leaf as .npy, .csv or .png after the run")
      ->allow_extra_args(false)
      ->type_name("NAME=FILE");
  std::string check_finite = "all";
  const CLI::Option* finite_option =
      eval_command
          ->add_option("--check-finite", check_finite,
                       "Stop at the first NaN or Inf: 'all' that an op makes, or 'results' that one reaches")
          ->expected(0, 1)
          ->check(CLI::IsMember({"all", "results"}));
  eval_command
      ->add_flag("--check-vjp", eval_options.check_vjp,
                 "Compare outputs with those of --plain-gradients; they should agree to 1e-6")
      ->excludes("--plain-gradients");
  eval_command->add_flag("--float32", eval_options.float32, "Round every op's result to float32");
  eval_command->add_option("--threads", eval_options.threads, "Threads to use, 0: all; no result depends on it")
      ->check(CLI::Range(0, 1024))
      ->capture_default_str();
  eval_command
      ->add_option("--freeze,--raster-from", eval_options.freeze,
                   "Take faces, tags and pinned values from this folder instead of computing them")
      ->type_name("DIR");
  eval_command->add_option("--dump-raster", eval_options.dump, "Folder to write faces, tags and pinned values to")
      ->type_name("DIR");

  ExplainGradOptions explain_grad_options;
  CLI::App* explain_grad_command = app.add_subcommand("explain-grad", "Say where a gradient flows and where it is cut");
  add_input(*explain_grad_command, explain_grad_options.input);
  explain_grad_command->add_option("loss", explain_grad_options.loss, "What is differentiated: an output or a let")
      ->required();
  explain_grad_command->add_option("x", explain_grad_options.target, "With respect to what: a leaf or a let")
      ->required();

  FormatOptions fmt_options;
  CLI::App* fmt_command = app.add_subcommand("fmt", "Print programs in their canonical layout");
  fmt_command->add_option("file", fmt_options.files, "Programs (.dr), or - for stdin")->required();
  add_diagnostics(*fmt_command, diagnostics);
  CLI::Option* in_place = fmt_command->add_flag("--in-place", fmt_options.in_place, "Rewrite the files");
  fmt_command->add_flag("--check", fmt_options.check, "Name the files that would change, with exit code 1 if any would")
      ->excludes(in_place);
  fmt_command
      ->add_option("--edition", fmt_options.edition,
                   "Carry programs over to this edition of the language: one that names none gets the line")
      ->type_name("NUMBER")
      ->check(CLI::IsMember({dr::dsl::kEdition}));

  std::string code_to_explain;
  CLI::App* explain_command = app.add_subcommand("explain", "Say what the code of a message means, or list all codes");
  explain_command->add_option("code", code_to_explain, "As in error[E0301]");

  DocOptions doc_options;
  CLI::App* doc_command = app.add_subcommand("doc", "Print the documentation of modules as Markdown");
  doc_command->add_option("file", doc_options.files, "Modules or programs (.dr), or - for stdin");
  doc_command->add_flag("--ops", doc_options.ops, "The ops that graphs are made of");
  doc_command->add_flag("--functions", doc_options.functions, "The names of the language's functions, a line each");
  doc_command->add_option("-o", doc_options.output, "File to write, - for stdout")
      ->capture_default_str()
      ->type_name("FILE");

  InputOptions lsp_options;
  CLI::App* lsp_command =
      app.add_subcommand("lsp", "Serve an editor: the Language Server Protocol on stdin and stdout");
  add_modules(*lsp_command, lsp_options);
  // Editors name the road that they talk on, and this is the one there is.
  bool stdio = true;
  lsp_command->add_flag("--stdio", stdio, "Talk on stdin and stdout, as it does without");

  // CLI11 would only say that a command is missing.
  std::vector<std::string> commands;
  for (const CLI::App* command : app.get_subcommands({})) commands.push_back(command->get_name());
  if (argc > 1 && argv[1][0] != '-' && std::ranges::find(commands, argv[1]) == commands.end()) {
    const auto nearest = dr::dsl::nearest_name(argv[1], commands);
    std::fprintf(stderr, "there is no command '%s'%s (see drc --help)\n", argv[1],
                 nearest ? (", did you mean '" + *nearest + "'?").c_str() : "");
    return kBadUsage;
  }

  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    const bool asked = error.get_exit_code() == 0;
    app.exit(error);
    return asked ? kOk : kBadUsage;
  }
  build_options.input.compile.shader_cache = !no_cache;
  build_options.input.compile.ablate.insert(build_options.input.compile.ablate.end(), no_skip.begin(), no_skip.end());
  if (passes_option->count() > 0) build_options.passes = passes;
  if (finite_option->count() > 0) eval_options.check_finite = check_finite.empty() ? "all" : check_finite;
  if (report_option->count() > 0) {
    if (build_options.report != "text" && build_options.report != "json") {
      std::fprintf(stderr, "error: --report is text or json, found '%s'\n", build_options.report.c_str());
      return kBadUsage;
    }
    if (build_command->get_option("--emit")->count() == 0) build_options.emit.clear();
  }
  // Nobody who names a bundle wants something else in it.
  if (build_command->get_option("--emit")->count() == 0 && build_options.output.ends_with(".drb"))
    build_options.emit = {"bundle"};
  if (dump_option->count() > 0) build_options.dump_ir = dump_ir;
  if (fmt_options.in_place && std::ranges::find(fmt_options.files, "-") != fmt_options.files.end()) {
    std::fprintf(stderr, "--in-place needs files, - is stdin\n");
    return kBadUsage;
  }
  const bool as_json = diagnostics == "json";
  const bool report_on_stderr =
      report_option->count() > 0 && !build_options.emit.empty() && build_options.output == "-";
  if (as_json && (dump_option->count() > 0 || build_options.time_passes || report_on_stderr)) {
    std::fprintf(stderr,
                 "--dump-ir, --time-passes and --report beside a product print text on stderr, where "
                 "--diagnostics=json is\n");
    return kBadUsage;
  }
  if (as_json) collect_messages();
  int code = kOk;
  if (check_command->parsed()) code = check(check_options);
  if (build_command->parsed()) code = build(build_options);
  if (inspect_command->parsed()) code = inspect(inspect_options);
  if (eval_command->parsed()) code = eval(eval_options);
  if (explain_grad_command->parsed()) code = explain_grad(explain_grad_options);
  if (fmt_command->parsed()) code = fmt(fmt_options);
  if (doc_command->parsed()) code = doc(doc_options);
  if (lsp_command->parsed()) code = lsp(lsp_options);
  if (explain_command->parsed()) code = explain(code_to_explain);
  write_messages();
  // What the system buffered may still find no room.
  if (code != kOk || (std::fflush(stdout) == 0 && std::ferror(stdout) == 0)) return code;
  std::fprintf(stderr, "error: cannot write to stdout\n");
  return kUserError;
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
