// SPDX-License-Identifier: Apache-2.0
#include "compiler/language_server/library_files.h"

#include <cstdint>
#include <fstream>

#include "compiler/lower/lower.h"

namespace dr::language_server {
namespace fs = std::filesystem;
namespace {

// Libraries of other compilers stay beside this one's: FNV-1a of all texts.
std::string library_name() {
  uint64_t hash = 0xcbf29ce484222325;
  for (const std::string_view module : lower::library_modules()) {
    const std::string_view text = lower::library_module(module).value_or("");
    for (const char c : text) hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001b3;
  }
  std::string name(16, '0');
  for (size_t i = 0; i < name.size(); ++i, hash >>= 4) name[i] = "0123456789abcdef"[hash & 15];
  return name;
}

const std::string& kept_library_name() {
  static const std::string kName = library_name();
  return kName;
}

}  // namespace

std::optional<std::string> library_file(const fs::path& folder, std::string_view module) {
  const auto text = lower::library_module(module);
  if (!text || folder.empty()) return std::nullopt;
  const fs::path file = folder / kept_library_name() / module;
  std::error_code error;
  if (fs::file_size(file, error) == text->size() && !error) return file.string();
  fs::create_directories(file.parent_path(), error);
  // Two servers may write at once: the file appears whole.
  const fs::path part = file.string() + "." + std::to_string(reinterpret_cast<uintptr_t>(&error)) + ".part";
  {
    std::ofstream out(part, std::ios::binary);
    out << *text;
    if (!out.flush()) return std::nullopt;
  }
  fs::permissions(part, fs::perms::owner_read | fs::perms::group_read | fs::perms::others_read, error);
  fs::rename(part, file, error);
  if (error) return std::nullopt;
  return file.string();
}

std::optional<std::string> module_of_file(const fs::path& folder, std::string_view path) {
  const std::string root = (folder / kept_library_name()).string() + "/";
  if (folder.empty() || !path.starts_with(root)) return std::nullopt;
  return std::string(path.substr(root.size()));
}

}  // namespace dr::language_server
