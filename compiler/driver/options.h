// SPDX-License-Identifier: Apache-2.0
// How a program is compiled: the one list of options, in the words of the command line.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

namespace dr::driver {

struct Options {
  std::string profile;  // a built-in name or a file
  // choices() has the words.
  std::string lower = "auto", raster = "auto", pack = "fused", scatter = "auto", float_profile = "strict";
  std::vector<std::string> ablate;  // of ablations(), and the names of compiler/backend/skips.h
  bool shader_cache = true;         // keep assembled shaders on disk
  std::vector<std::string> include_dirs;
  std::map<std::string, std::string, std::less<>> defines;
  // As lower::Options has them: what inputs are known to be, and what the host binds.
  std::map<std::string, std::vector<double>, std::less<>> known;
  std::optional<std::map<std::string, bool, std::less<>>> bound;
  std::vector<std::string> adjoints;  // STEP:LEAF,...:OUTPUT,...: steps to be added (passes::add_adjoint)
  bool plain_gradients = false;       // differentiate functions that have a @vjp by their own text
  friend bool operator==(const Options&, const Options&) = default;
};

// An option that is one word, as commands (--name=word) and the C interface (name, word) take it.
struct Choice {
  std::string name, text;  // a help text in lower case
  std::string Options::*value = nullptr;
  std::vector<std::string> words;  // those there are; empty: any
};
const std::vector<Choice>& choices();

// What `--ablate` switches off; what `--no-skip` does is in compiler/backend/skips.h.
const std::vector<std::string>& ablations();

// `text` as the value of a known input: numbers with commas.
std::optional<std::vector<double>> known_value(const std::string& text);

// The options as words of drc's command line, those that are not the default ones: how a graph becomes a bundle. What
// only reading a text takes (folders, defines, adjoints) and where shaders are kept is not among them.
std::string command_line(const Options& options);

}  // namespace dr::driver
