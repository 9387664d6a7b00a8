// SPDX-License-Identifier: Apache-2.0
// Syntax trees -> graph. Checking is done here, by elaboration: functions inline, generics and extents are
// bound by the arguments of each call, compile-time values (constants, arrays, structs, functions) disappear, and what
// is left are ops on images.
#pragma once

#include <cstddef>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "compiler/ir/graph.h"
#include "dsl/diagnostic/diagnostic.h"
#include "dsl/source/source.h"
#include "dsl/syntax/ast.h"

namespace dr::lower {

struct Observation;  // compiler/lower/program/observation.h

struct Options {
  std::vector<std::string> include_dirs;  // -I
  // -D name=value, overriding `const`s of the root file, or by std.loss.name those of a library module.
  std::map<std::string, std::string, std::less<>> defines;
  bool plain_gradients = false;  // differentiate functions that have a @vjp by their own text
  // Inputs of one element, by name, that keep a value: what it makes zero, `known_zero(x)` says so. Nobody may bind
  // another one.
  std::map<std::string, std::vector<double>, std::less<>> known;
  // The leaves that the host binds, where it says so: by name, whether to zeros. It binds no others then, and none
  // anew.
  std::optional<std::map<std::string, bool, std::less<>>> bound;
  std::set<std::string, std::less<>> open;  // inputs that may get any value nevertheless
  bool find_zeros = true;                   // else `known_zero(x)` is false
  struct ZeroCount {
    size_t zero = 0, other = 0;
  };
  ZeroCount* zero_count = nullptr;  // the answers of `known_zero(x)`, if anybody wants them
  // What a program may come to after unrolling; more is an error.
  size_t max_ops = 1'000'000;
  size_t max_expressions = 50'000'000;
  size_t max_parts = 262'144;  // of one tuple, array or struct, parts of parts counted
  size_t max_steps = 1024;
  double* parse_milliseconds = nullptr;  // what parsing took is added here, if anywhere
  Observation* observation = nullptr;    // who wants to know, if anybody
};

// The text of a library module that ships inside the compiler ("std/camera.dr"), or nullopt.
std::optional<std::string_view> library_module(std::string_view path);
// The paths of them all.
std::vector<std::string_view> library_modules();

// The names that the language gives to functions and to types.
std::vector<std::string> builtin_names();
std::vector<std::string> type_names();

// Parses and lowers a root file already in `sources`, with what it imports. Diagnostics say what is wrong; a
// graph is returned only when there are no errors. It contains Grad ops; passes::differentiate expands them.
std::optional<ir::Graph> lower(dsl::SourceManager& sources, dsl::FileId root, const Options& options,
                               dsl::DiagnosticList& diagnostics);

}  // namespace dr::lower
