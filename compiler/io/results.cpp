// SPDX-License-Identifier: Apache-2.0
// Results by name and as files.
#include "compiler/io/results.h"

#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <filesystem>
#include <sstream>
#include <system_error>
#include <utility>

#include "compiler/io/file/failure.h"
#include "compiler/io/file/file.h"
#include "compiler/io/picture/image.h"

namespace dr::io {

namespace fs = std::filesystem;

namespace {

constexpr const char* kList = "results.txt";
constexpr const char* kHeading = "# Files of a run of drun or drc eval; the next run into this folder removes them.\n";

bool is_picture(const Array& a) {
  const bool floats = a.kind == ElementKind::Float32 || a.kind == ElementKind::Float64;
  return floats && a.height > 1 && a.components <= 4 && a.components != 2;
}

// The list is a file that anybody may have written: only names of results in the folder itself count.
bool is_result(std::string_view name) {
  return name.find('/') == std::string_view::npos && !name.starts_with(".") &&
         (name.ends_with(".npy") || name.ends_with(".png"));
}

std::string list_of(std::vector<std::string> names) {
  std::sort(names.begin(), names.end());
  std::string out;
  for (const std::string& name : names) out += (out.empty() ? "" : ", ") + name;
  return out;
}

// What may have been meant by `name`, or all that there are.
std::string near_or_all(const std::string& name, std::span<const std::string_view> words,
                        const std::vector<std::string>& all) {
  const std::string near = did_you_mean(name, words);
  return near.empty() ? "; there are: " + list_of(all) : near;
}

constexpr const char* kRename = ": give the output another name";

// Of a leaf, without what to do.
std::optional<std::string> shared_name(const std::string& leaf, const ResultNames& names) {
  for (const auto& [step, outputs] : names.steps)
    for (const std::string& output : outputs)
      if (leaf == ResultName{step, output}.str())
        return "'" + leaf + "' is a leaf and an output of step '" + step + "'";
  return std::nullopt;
}

}  // namespace

std::optional<std::string> shared_name(const ResultNames& names) {
  for (const std::string& leaf : names.leaves)
    if (const auto found = shared_name(leaf, names)) return *found + ", and both would be one file of --out" + kRename;
  return std::nullopt;
}

Result<ResultName> find_result(const std::string& text, const ResultNames& names) {
  if (std::ranges::find(names.leaves, text) != names.leaves.end()) {
    if (const auto found = shared_name(text, names)) return Error{*found + kRename};
    return ResultName{"", text};
  }
  std::vector<std::string> all = names.leaves, whole, short_names;
  std::vector<ResultName> found;
  for (const auto& [step, outputs] : names.steps)
    for (const std::string& output : outputs) {
      const ResultName name{step, output};
      if (text == name.str()) return name;
      if (text == output) found.push_back(name);
      whole.push_back(name.str());
      short_names.push_back(output);
    }
  if (found.size() == 1) return found[0];
  if (found.size() > 1) {
    std::string which;
    for (const ResultName& name : found) which += (which.empty() ? "" : " or ") + name.str();
    return Error{"several steps have an output '" + text + "': write " + which};
  }
  all.insert(all.end(), whole.begin(), whole.end());
  std::vector<std::string_view> words(all.begin(), all.end());
  words.insert(words.end(), short_names.begin(), short_names.end());
  return Error{"there is no leaf '" + text + "', and no such output of the steps that run" +
               near_or_all(text, words, all)};
}

std::string unknown_name(const std::string& kind, const std::string& name, const std::vector<std::string>& all) {
  const std::vector<std::string_view> words(all.begin(), all.end());
  return cat("there is no ", kind, " ", in_quotes(name), near_or_all(name, words, all));
}

Result<void> check_output_file(const std::string& path, std::span<const std::string_view> extensions,
                               const std::string& out) {
  return guarded(cat("cannot write ", path_in_quotes(path), ": "), [&] {
    const std::string extension = extension_of(path);
    if (std::ranges::find(extensions, extension) == extensions.end()) {
      std::string all;
      for (const std::string_view e : extensions) all += cat(all.empty() ? "" : ", ", e);
      fail(extension.empty() ? std::string("there is no extension") : cat("unknown extension ", in_quotes(extension)),
           did_you_mean(extension, extensions), ", expected one of ", all);
    }
    const fs::path folder = fs::path(path).parent_path();
    std::error_code error;
    const auto place = [&](const fs::path& of) { return fs::weakly_canonical(fs::absolute(of / "", error), error); };
    const bool is_out = !out.empty() && !folder.empty() && place(folder) == place(out);
    if (is_out && !fs::exists(folder, error)) return;
    if (!folder.empty() && !fs::is_directory(folder, error))
      fail("there is no folder ", path_in_quotes(folder.string()));
    if (::access(folder.empty() ? "." : folder.c_str(), W_OK) != 0)
      fail("nothing can be written into ", folder.empty() ? "this folder" : path_in_quotes(folder.string()));
    if (fs::is_directory(path, error)) fail("it is a folder");
  });
}

Result<void> check_saved(const std::string& path, ElementKind kind, int components, const std::string& out) {
  constexpr std::string_view kExtensions[] = {".png", ".npy", ".csv"};
  if (auto checked = check_output_file(path, kExtensions, out); !checked) return checked;
  if (extension_of(path) != ".png") return {};
  return guarded(cat("cannot write ", path_in_quotes(path), ": "), [&] {
    if (kind == ElementKind::Int32 || kind == ElementKind::UInt32)
      fail("a PNG holds floats in 0 to 1 or bools, found ", kind_name(kind), "; .npy holds any kind");
    if (components > 4) fail("a PNG holds 1 to 4 components, found ", components);
  });
}

Result<void> make_results_folder(const std::string& path) {
  std::error_code error, ignored;
  fs::create_directories(path, error);
  if (!fs::is_directory(path, ignored)) return Error{"cannot make the folder '" + path + "': " + error.message()};
  if (::access(path.c_str(), W_OK) != 0)
    return Error{"nothing can be written into the folder '" + path + "': " + std::generic_category().message(errno)};
  return {};
}

ResultsFolder::ResultsFolder(std::string path) : path_(std::move(path)) {
  std::error_code error;
  if (!fs::is_regular_file(file(kList), error)) return;
  try {
    const Bytes bytes = read_file(file(kList));
    std::stringstream text{std::string(as_text(bytes))};
    for (std::string line; std::getline(text, line);)
      if (is_result(line)) known_.insert(line);
  } catch (const Failure&) {  // then nothing is known of what is there
  }
}

Result<void> ResultsFolder::write_list(const std::set<std::string>& names) const {
  std::string text = kHeading;
  for (const std::string& name : names) text += name + "\n";
  return guarded(cat("cannot write ", path_in_quotes(file(kList)), ": "), [&] {
    write_file(file(kList), {text.begin(), text.end()});
  });
}

bool ResultsFolder::done(const Result<void>& result) {
  // Files that share their list fail alike.
  if (!result && failed_.find(result.error()) == std::string::npos)
    failed_ += (failed_.empty() ? "" : "; ") + result.error();
  return result.ok();
}

// The pictures of an output's layers, by their names; none where no PNG can hold them, as with a NaN: the array is
// there.
std::vector<OutputFile> ResultsFolder::pictures(const std::string& name, const Array& array) {
  std::vector<OutputFile> layers;
  try {
    for (int64_t layer = 0; layer < array.layers; ++layer) {
      const std::string picture = layer_path(name + ".png", layer, array.layers);
      if (const auto other = written_.find(picture); other != written_.end() && other->second != name)
        fail("'", other->second, "' has a picture of that name, too: one of both wants another one");
      layers.push_back({picture, encode_png(array, layer)});
    }
  } catch (const Failure& failure) {
    warnings_.push_back(cat("cannot write ", path_in_quotes(file(name + ".png")), ": ", failure.what()));
    return {};
  }
  return layers;
}

void ResultsFolder::add(const ResultName& result, const Array& array) {
  const std::string name = result.str();
  std::set<std::string> names = {name + ".npy"};
  std::vector<OutputFile> layers;
  if (!result.step.empty() && is_picture(array)) layers = pictures(name, array);
  for (OutputFile& layer : layers) names.insert(std::exchange(layer.path, file(layer.path)));
  for (const std::string& each : names) written_[each] = name;
  // The list is there before the files are: whoever ends the program in between leaves nothing that is unknown.
  if (!std::ranges::includes(known_, names)) {
    known_.insert(names.begin(), names.end());
    if (!done(write_list(known_))) return;
  }
  done(save_array(file(name + ".npy"), array));
  if (!layers.empty())
    done(guarded(cat("cannot write ", path_in_quotes(file(name + ".png")), ": "), [&] { write_files(layers); }));
}

Result<void> ResultsFolder::finish(bool keep) {
  if (!failed_.empty()) return Error{failed_};
  if (keep) return {};
  for (const std::string& name : known_)
    if (!written_.contains(name)) {
      std::error_code error;
      fs::remove(file(name), error);
      if (error) return Error{"cannot remove '" + file(name) + "' of an earlier run: " + error.message()};
    }
  known_.clear();
  for (const auto& [name, result] : written_) known_.insert(name);
  return write_list(known_);
}

}  // namespace dr::io
