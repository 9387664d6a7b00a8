// SPDX-License-Identifier: Apache-2.0
// What the commands of drc share: exit codes and options. A command prints its products on stdout and everything else
// on stderr.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "compiler/driver/options.h"

namespace dr::drc {

// Documented in --help; scripts rely on them.
enum ExitCode : int { kOk = 0, kUserError = 1, kBadUsage = 2, kInternalError = 3 };

// A program and how to read it. `.ir` files are graphs in text form, `.schedule` files graphs with their schedule,
// anything else is source; `-` is stdin.
struct InputOptions {
  std::string file;
  std::vector<std::string> defines;  // -D name=value
  std::vector<std::string> known;    // --known name=value
  driver::Options compile;
};

struct BuildOptions {
  InputOptions input;
  std::vector<std::string> emit = {"ir"};
  std::string output = "-";
  std::optional<std::vector<std::string>> passes;  // instead of those that the product needs
  std::optional<std::string> dump_ir;              // after this pass, or all of them if empty
  std::string stop_after;                          // the last pass to run; empty: all do
  std::string break_after;                         // the pass that is made to fail
  bool time_passes = false;
  bool verify_each = true;
  std::string report;                // empty, text or json
  std::vector<std::string> symbols;  // W=32, for the report
};

struct InspectOptions {
  std::string file;  // a bundle
  bool json = false;
  bool graph = false;  // the graph's text instead of the tables
};

struct EvalOptions {
  InputOptions input;
  std::vector<std::string> binds;    // leaf=source
  std::vector<std::string> symbols;  // W=32
  std::vector<std::string> steps;    // name or name=times, in order; empty: all, in the order written
  int64_t times = 1;                 // of steps without a number of their own
  std::string out;                   // a folder for all outputs, or empty
  std::vector<std::string> saves;    // name=file: an output or leaf
  std::string check_finite;          // empty: no; all, results
  bool float32 = false;
  bool check_vjp = false;  // compare gradients with those of --plain-gradients
  int threads = 0;
  std::string freeze, dump;  // folders of decisions, or empty
};

struct ExplainGradOptions {
  InputOptions input;
  std::string loss, target;  // names of lets, outputs or leaves
};

struct FormatOptions {
  std::vector<std::string> files;
  bool in_place = false;
  bool check = false;
  std::optional<int64_t> edition;
};

struct DocOptions {
  std::vector<std::string> files;  // modules, or
  bool ops = false;                // the table of ops, or
  bool functions = false;          // the names of the language's functions
  std::string output = "-";
};

int check(const InputOptions& options);
int build(const BuildOptions& options);
int eval(const EvalOptions& options);
int explain_grad(const ExplainGradOptions& options);
int fmt(const FormatOptions& options);
int doc(const DocOptions& options);
int lsp(const InputOptions& options);  // only where modules are, and -D
int explain(const std::string& code);  // all codes if it is empty
int inspect(const InspectOptions& options);

// The products that `build` knows, for --help.
std::vector<std::string> product_names();

}  // namespace dr::drc
