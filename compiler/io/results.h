// SPDX-License-Identifier: Apache-2.0
// The results of runs by name and as files, for drun and drc alike: an output is STEP.NAME, a leaf NAME.
#pragma once

#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "compiler/io/array/array.h"
#include "compiler/io/file/file.h"

namespace dr::io {

// What a run gives: its steps with the names of their outputs, and leaves.
struct ResultNames {
  std::vector<std::pair<std::string, std::vector<std::string>>> steps;
  std::vector<std::string> leaves;
};

struct ResultName {
  std::string step, name;  // no step: a leaf
  std::string str() const { return step.empty() ? name : step + "." + name; }
};

// The name that a leaf and an output of a step share, in a sentence, if there is one: both would be one file.
std::optional<std::string> shared_name(const ResultNames& names);

// What a user means by STEP.NAME, or by NAME: a leaf or, where none has the name, the output of the one step that has
// it.
Result<ResultName> find_result(const std::string& text, const ResultNames& names);

// "there is no leaf 'positon' (did you mean 'position'?)", or all that there are.
std::string unknown_name(const std::string& kind, const std::string& name, const std::vector<std::string>& all);

// "name=file" of `--save`. Whether it can be written is known before a run that takes hours: the extension, the folder,
// and whether a picture can hold such elements. The folder `out` need not be there, as it is made before.
Result<void> check_output_file(const std::string& path, std::span<const std::string_view> extensions,
                               const std::string& out = "");
Result<void> check_saved(const std::string& path, ElementKind kind, int components, const std::string& out = "");

// The folder of `--out`, unless it is there; whether files can be written into it is known before a run, too.
Result<void> make_results_folder(const std::string& path);

// A folder of results. The files that runs wrote stand in its list, `results.txt`: what the run before left, and this
// one does not write anew, goes when finish() is called. Until then it stays. Nothing else is touched.
class ResultsFolder {
 public:
  explicit ResultsFolder(std::string path);
  // NAME.npy and, of an output of floats with a height above 1 that a picture can hold, NAME.png. A picture with a NaN
  // is left out with a warning. What cannot be written costs nothing that comes after it: finish() tells.
  void add(const ResultName& name, const Array& array);
  // Fails where something was not written; what the run before left stays then, and with `keep`: this one went on with
  // it.
  Result<void> finish(bool keep);
  const std::vector<std::string>& warnings() const { return warnings_; }

 private:
  std::string file(const std::string& name) const { return path_ + "/" + name; }
  Result<void> write_list(const std::set<std::string>& names) const;
  std::vector<OutputFile> pictures(const std::string& name, const Array& array);
  // Whether it is done; else finish() tells.
  bool done(const Result<void>& result);

  std::string path_;
  std::set<std::string> known_;                 // in the list
  std::map<std::string, std::string> written_;  // files of this run, and what each is of
  std::vector<std::string> warnings_;
  std::string failed_;  // what was not written, and why
};

}  // namespace dr::io
