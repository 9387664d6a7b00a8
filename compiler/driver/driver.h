// SPDX-License-Identifier: Apache-2.0
// From the text of a program to whatever is asked of it: a graph, a schedule, shaders, a bundle. Commands, the compiler
// at run time, tests and benchmarks are shells around this.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "compiler/backend/compile.h"
#include "compiler/driver/options.h"
#include "compiler/ir/graph.h"
#include "compiler/passes/passes.h"
#include "compiler/target/profile.h"
#include "dsl/diagnostic/diagnostic.h"
#include "dsl/source/source.h"

namespace dr::driver {

// What went wrong beside the diagnostics of the program. What is the compiler's own mistake is thrown
// (ir/internal_error.h).
struct Error {
  enum class Kind : uint8_t {
    User,   // the input or an option
    Limit,  // of the profile: the program may be right on another device
  };
  Kind kind = Kind::User;
  std::string text;
  uint32_t line = 0;  // of a graph's text, counted from 1; 0: none
};

// For those who watch the passes.
struct Hooks {
  bool verify_each = false;                        // graphs and schedules are checked after each pass
  std::optional<std::vector<std::string>> passes;  // over graphs, instead of the default ones
  std::string stop_after;                          // the last pass to run; empty: all do
  std::string break_after;                         // a pass over schedules; see backend::PassHooks
  // Called after each pass with its name, what prints its result, and the
  // milliseconds that it took.
  std::function<void(std::string_view, const std::function<std::string()>&, double)> after = {};
};

// A program on its way. Each stage is made when it is first asked for; null says that it failed, and why is in
// diagnostics() and error().
class Compilation {
 public:
  // `name` stands for the file in messages; one that ends in .ir is the text of a graph, one in .schedule that of a
  // graph and its schedule.
  Compilation(std::string name, std::string text, Options options, Hooks hooks = {});

  const target::Profile* profile();
  void use_profile(target::Profile profile) { profile_ = std::move(profile); }

  const ir::Graph* lowered();         // as checked; it may have Grad ops, but for that of a schedule
  const ir::Graph* differentiated();  // after the passes over graphs
  const backend::Compiled* compiled();

  const dsl::SourceManager& sources() const { return sources_; }
  const dsl::DiagnosticList& diagnostics() const { return diagnostics_; }
  const std::optional<Error>& error() const { return error_; }
  dsl::FileId file() const { return file_; }  // of the text
  const passes::Skips::LeftOut& left_out() const { return left_out_; }
  // Of lowered(): what its text and the modules that it imports took.
  double parse_milliseconds() const { return parse_milliseconds_; }
  // All messages as text, each line ended.
  std::string messages() const;

 private:
  std::nullptr_t fail(Error error);
  const ir::Graph* read_graph();
  std::optional<Error> wrong_schedule();
  std::optional<Error> wrong_known() const;
  template <typename Make>
  auto keeping_reproducer(const ir::Graph& graph, const Make& make);

  Options options_;
  Hooks hooks_;
  dsl::SourceManager sources_;
  dsl::FileId file_;
  bool is_graph_, is_schedule_;
  backend::Schedule schedule_;  // as read
  dsl::DiagnosticList diagnostics_;
  std::optional<Error> error_;
  std::optional<target::Profile> profile_;
  std::optional<ir::Graph> lowered_, differentiated_;
  std::optional<backend::Compiled> compiled_;
  passes::Skips::LeftOut left_out_;
  double parse_milliseconds_ = 0;
};

// The passes that --stop-after knows: those over graphs, which --passes knows, over schedules, and over bundles.
std::vector<std::string> graph_pass_names();
std::vector<std::string> schedule_pass_names();
std::vector<std::string> bundle_pass_names();

// Keeps the graph, the options and the message where a person finds them, and returns the file's name; empty where
// nothing can be written.
std::string keep_reproducer(const ir::Graph& graph, const Options& options, const std::string& message);

}  // namespace dr::driver
