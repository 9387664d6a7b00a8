// SPDX-License-Identifier: Apache-2.0
// What check() is made of: check.cpp looks at tables, check_command.cpp at commands. Every field of bundle.fbs is
// looked at in one of them, whatever the kind of what it stands in; tests/unit/backend/bundle_fields_test.sh holds them
// to it.
#pragma once

#include <map>
#include <set>
#include <string>
#include <vector>

#include "compiler/backend/bundle/bundle.h"

namespace dr::bundle {

// Each function says whether all is well; the first that is not is the problem.
class Checker {
 public:
  explicit Checker(const BundleT& bundle) : b_(bundle) {}
  std::string process();

 private:
  bool fail(const std::string& what);

  // check.cpp: texts. Names become names of files; titles are printed, or stand in a page.
  bool name(const std::string& text, const std::string& what);
  bool title(const std::string& text, const std::string& what);
  bool text(const std::string& text, const std::string& what);
  bool unique(std::set<std::string>& known, const std::string& name, const std::string& what);
  // Expressions, types, indices.
  bool expression(const std::string& text, const std::string& where);
  bool extent(const std::unique_ptr<ExtentT>& extent, const std::string& where);
  bool type(const std::unique_ptr<TypeT>& type, const std::string& where);
  bool resource(int64_t index, const std::string& where);
  bool storage(int64_t index, Storage wanted, const std::string& where);
  // What is there when its command has run.
  bool kept(int64_t index, const std::string& where);
  bool shader(int64_t index, Stage stage, const std::string& where);
  // Ascending, and each below `count`.
  bool indices(const std::vector<uint32_t>& all, size_t count, const std::string& what, const std::string& where);
  bool line(const Line& line, const std::string& where);

  // check.cpp: tables
  bool header();
  bool resources();
  bool leaf(size_t index);
  bool leaves();
  bool tables_of_leaves();
  bool shaders();
  bool step(const StepT& step);
  bool counter(const StepT& step, const std::string& where);
  bool results(const StepT& step, const std::string& where);
  bool raster(const RasterResultsT& raster, const std::string& where);

  // check_command.cpp
  bool commands(const StepT& step);
  bool command(const CommandT& command, const std::string& where);
  bool only_own_fields(const CommandT& command, const std::string& where);
  bool bindings(const CommandT& command, const std::string& where);
  bool trips(const CommandT& c, const std::string& where);
  bool left(const CommandT& c, const std::string& where);
  bool watched(const CommandT& c, int word, const std::string& where);
  bool dispatch(const CommandT& command, const std::string& where);
  bool draw(const CommandT& command, const std::string& where);
  bool copy(const CommandT& command, const std::string& where);
  bool reduce(const CommandT& command, const std::string& where);
  // A subpass belongs to the render pass of the draw before it and reads what that render pass wrote.
  bool subpass(const StepT& step, size_t index, const std::string& where);
  bool attachments(const StepT& step, size_t index, std::set<uint32_t>& written, const std::string& where);
  // What a command reads is there: leaves that the step needs, values and scratch memory that
  // a command before it wrote.
  bool touches(const StepT& step, const CommandT& command, const std::string& where);
  bool holds(uint32_t index) const;

  const BundleT& b_;
  std::string problem_;
  std::vector<int> leaf_of_;             // by resource: the leaf that lives there, or -1
  std::map<uint32_t, uint32_t> holder_;  // by slot: the resource that a command of the step wrote there last
};

}  // namespace dr::bundle
