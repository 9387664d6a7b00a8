// SPDX-License-Identifier: Apache-2.0
// Checkpoints as files.
#include "runtime/drun/checkpoint.h"

#include <algorithm>
#include <cerrno>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>
#include <system_error>

#include "compiler/backend/bundle/bundle.h"
#include "runtime/drun/out_folder.h"
#include "runtime/drun/target.h"

namespace dr::drun {

namespace fs = std::filesystem;
using io::Array;
using nlohmann::ordered_json;

namespace {

constexpr const char* kFile = "checkpoint.json";

ordered_json read_json(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file || fs::is_directory(path))
    throw Mistake{"there is no checkpoint to resume from: cannot read '" + path.string() + "'"};
  ordered_json json = ordered_json::parse(file, nullptr, false);
  if (json.is_discarded() || !json.is_object()) throw Mistake{"'" + path.string() + "' is no checkpoint of drun"};
  return json;
}

// The folder that the file names; empty where there is none.
std::string folder_in_use(const std::string& out) {
  std::ifstream file(fs::path(out) / kFile, std::ios::binary);
  if (!file || fs::is_directory(fs::path(out) / kFile)) return {};
  const ordered_json json = ordered_json::parse(file, nullptr, false);
  return json.is_object() && json.contains("folder") && json["folder"].is_string() ? json["folder"] : "";
}

std::span<const std::byte> bytes_of(const std::string& text) { return std::as_bytes(std::span(text)); }

// Throws where the content of `path` is not what was written.
void expect(const ordered_json& checksum, const std::string& found, const fs::path& path) {
  if (checksum != found) throw Mistake{"'" + path.string() + "' is damaged, its checksum differs"};
}

// Whether it is the name of a folder that save_checkpoint() made: nothing else is read or removed.
bool is_own_folder(const std::string& name) {
  return name.starts_with(kCheckpoint) && name.find('/') == std::string::npos;
}

}  // namespace

std::string checksum_of(std::span<const std::byte> bytes) {
  std::ostringstream text;
  text << std::hex << bundle::checksum(bytes.data(), bytes.size());
  return text.str();
}

void write_text(const std::string& path, const std::string& text) {
  const std::string temporary = path + ".partial";
  std::error_code error;
  try {
    errno = 0;
    std::ofstream file(temporary, std::ios::binary);
    file << text;
    file.close();
    if (!file)
      throw Mistake{"cannot write '" + path + "'" +
                    (errno == 0 ? std::string() : ": " + std::generic_category().message(errno))};
    sync_to_disk(temporary);
    fs::rename(temporary, path, error);
    if (error) throw Mistake{"cannot write '" + path + "': " + error.message()};
  } catch (...) {
    fs::remove(temporary, error);
    throw;
  }
}

namespace {

// The folder `name` in `out`, and then the file that names it.
void save_checkpoint_as(const std::string& out, const std::string& name, const Checkpoint& c) {
  ordered_json json{{"folder", name}, {"steps", c.steps},     {"entry", c.entry}, {"done", c.done},
                    {"runs", c.runs}, {"program", c.program}, {"data", c.data}};
  const auto save = [&](const std::string& what, const Array& data) -> ordered_json {
    const std::string file = (fs::path(out) / name / (what + ".npy")).string();
    must(io::save_array(file, data));
    sync_to_disk(file);
    return {{"name", what}, {"components", data.components}, {"checksum", checksum_of(data.bytes)}};
  };
  json["leaves"] = ordered_json::array();
  for (const auto& [leaf, data] : c.leaves) json["leaves"].push_back(save(leaf, data));
  json["outputs"] = ordered_json::array();
  for (const auto& [step, outputs] : c.outputs)
    for (const auto& [output, data] : outputs) json["outputs"].push_back(save(step + "." + output, data));
  json["log"] = checksum_of(bytes_of(c.log));
  write_text((fs::path(out) / name / "log.jsonl").string(), c.log);
  json["checksum"] = checksum_of(bytes_of(json.dump()));
  // All that the file names is on the disk before the file is, and the file before what it named goes.
  sync_to_disk((fs::path(out) / name).string());
  sync_to_disk(out);
  write_text((fs::path(out) / kFile).string(), json.dump(2) + "\n");
  sync_to_disk(out);
}

}  // namespace

void save_checkpoint(const std::string& out, const Checkpoint& c) {
  // A folder of another name than the one in use, which stays until the file names the new one.
  const std::string before = folder_in_use(out);
  int number = 0;
  while (fs::exists(fs::path(out) / (std::string(kCheckpoint) + std::to_string(number)))) ++number;
  const std::string name = std::string(kCheckpoint) + std::to_string(number);
  std::error_code error;
  fs::create_directories(fs::path(out) / name, error);
  if (error) throw Mistake{"cannot make the folder '" + (fs::path(out) / name).string() + "': " + error.message()};
  try {
    save_checkpoint_as(out, name, c);
  } catch (...) {
    // A half takes room that the next one may need.
    if (folder_in_use(out) != name) fs::remove_all(fs::path(out) / name, error);
    throw;
  }
  // Nothing but what the file pointed to.
  if (is_own_folder(before) && before != name) fs::remove_all(fs::path(out) / before, error);
}

std::string checkpoint_folder(const std::string& out) {
  const std::string folder = folder_in_use(out);
  return is_own_folder(folder) ? folder : "";
}

Checkpoint load_checkpoint(const std::string& out) {
  const fs::path file = fs::path(out) / kFile;
  ordered_json json = read_json(file);
  Checkpoint c;
  try {
    const ordered_json checksum = json.at("checksum");
    json.erase("checksum");
    expect(checksum, checksum_of(bytes_of(json.dump())), file);
    const std::string folder = json.at("folder");
    if (!is_own_folder(folder)) throw Mistake{"'" + file.string() + "' is no checkpoint of drun"};
    c.steps = json.at("steps").get<std::vector<std::pair<std::string, int>>>();
    c.entry = json.at("entry");
    c.done = json.at("done");
    c.runs = json.at("runs").get<std::map<std::string, int64_t>>();
    c.program = json.value("program", "");
    c.data = json.value("data", c.data);
    const bool counts = std::ranges::all_of(c.runs, [](const auto& run) { return run.second >= 0; });
    if (c.entry >= c.steps.size() || c.done < 0 || !counts)
      throw Mistake{"'" + file.string() + "' is no checkpoint of drun"};
    const auto load = [&](const ordered_json& entry) {
      const int components = entry.at("components");
      if (components < 1) throw Mistake{"'" + file.string() + "' is no checkpoint of drun"};
      const fs::path array = fs::path(out) / folder / (entry.at("name").get<std::string>() + ".npy");
      Array data = must(io::load_binding(array.string(), components));
      expect(entry.at("checksum"), checksum_of(data.bytes), array);
      return data;
    };
    for (const auto& leaf : json.at("leaves")) c.leaves.emplace_back(leaf.at("name"), load(leaf));
    for (const auto& output : json.at("outputs")) {
      const std::string name = output.at("name");
      const size_t dot = std::min(name.find('.'), name.size());
      c.outputs[name.substr(0, dot)].emplace_back(name.substr(std::min(dot + 1, name.size())), load(output));
    }
    const fs::path lines = fs::path(out) / folder / "log.jsonl";
    std::ifstream log(lines, std::ios::binary);
    std::stringstream text;
    text << log.rdbuf();
    c.log = text.str();
    expect(json.at("log"), checksum_of(bytes_of(c.log)), lines);
  } catch (const nlohmann::json::exception&) {
    throw Mistake{"'" + file.string() + "' is no checkpoint of drun"};
  }
  return c;
}

}  // namespace dr::drun
