// SPDX-License-Identifier: Apache-2.0
// What a run leaves behind: outputs, params and states as files, and meshes.
#pragma once

#include <set>
#include <string>
#include <vector>

#include "runtime/drun/options.h"
#include "runtime/drun/target.h"

namespace dr::drun {

class Results {
 public:
  // `names` has the tables of the program that `target` runs.
  Results(const Target& target, const runtime::Program& names) : target_(target), names_(names) {}
  // Of the steps that ran, into a folder. All throw Mistake.
  void write_outputs(const std::string& folder, const std::set<std::string>& ran) const;
  // Params and states that have a value; what was bound as input is the user's already. Without a value is a leaf that
  // no step which ran needs.
  std::vector<std::pair<std::string, io::Array>> leaves(const std::set<std::string>& ran) const;
  // `what` is POSITION:FACE[:UV[:UV_FACE[:TEXTURE]]][:PART=NAME ...], each name an output or a leaf.
  void write_mesh(const std::string& file, const std::string& what, const std::set<std::string>& ran) const;

 private:
  bool changed(const std::string& leaf) const { return !names_.is_input(leaf); }
  io::Array named(const std::string& name, const std::set<std::string>& ran) const;

  const Target& target_;
  const runtime::Program& names_;
};

// "1.5", as short as it can be.
std::string number_text(double value);

}  // namespace dr::drun
