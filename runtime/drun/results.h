// SPDX-License-Identifier: Apache-2.0
// What a run leaves behind: outputs, params and states as files, and meshes.
#pragma once

#include <functional>
#include <map>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "compiler/io/results.h"
#include "runtime/drun/checkpoint.h"
#include "runtime/drun/options.h"
#include "runtime/drun/target.h"

namespace dr::drun {

class Results {
 public:
  // `names` has the tables of the program that `target` runs; `held` are outputs of steps that ran before it was
  // loaded.
  Results(const Target& target, const runtime::Program& names, const std::map<std::string, Outputs>& held = kNone)
      : target_(target), names_(names), held_(held) {}
  // Before the steps run, finds what --save and --mesh ask for, and whether it can be written. All throw Mistake.
  void check(const Options& options, const std::set<std::string>& steps) const;
  // What a file gets is looked at first.
  void look_with(std::function<void(const io::ResultName&, const io::Array&)> look) { look_ = std::move(look); }
  // Of the steps that ran, into a folder; with `keep`, what is there of earlier runs stays.
  void write_outputs(const std::string& folder, const std::set<std::string>& ran,
                     const std::vector<std::pair<std::string, io::Array>>& leaves, bool keep) const;
  // Params and states that have a value; what was bound as input is the user's already. Without a value is a leaf that
  // no step which ran needs.
  std::vector<std::pair<std::string, io::Array>> leaves(const std::set<std::string>& ran) const;
  Outputs outputs(const std::string& step) const;
  // What --save and --mesh ask for, of the steps that ran.
  // Of what the steps that ran give; with `stopped`, others were to run, and theirs is left out with a word.
  void write_asked(const Options& options, const std::set<std::string>& ran, bool stopped) const;

 private:
  static inline const std::map<std::string, Outputs> kNone;
  io::Array output(const std::string& step, const std::string& name) const;
  bool changed(const std::string& leaf) const { return !names_.is_input(leaf); }
  io::ResultNames names_of(const std::set<std::string>& steps) const;
  io::ResultName found(const std::string& name, const std::set<std::string>& steps) const;
  runtime::Program::LeafInfo info(const io::ResultName& name) const;
  // An output that a file gets.
  io::Array written(const std::string& step, const std::string& name) const;
  io::Array named(const std::string& name, const std::set<std::string>& ran) const;
  void write_mesh(const std::string& file, const std::string& what, const std::set<std::string>& ran) const;

  const Target& target_;
  const runtime::Program& names_;
  const std::map<std::string, Outputs>& held_;
  std::function<void(const io::ResultName&, const io::Array&)> look_;
};

// "1.5", as short as it can be: a float's digits unless it is `whole`, of float64.
std::string number_text(double value, bool whole);

}  // namespace dr::drun
