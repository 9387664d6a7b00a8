// SPDX-License-Identifier: Apache-2.0
#include "compiler/drc/bundle_cache.h"

#include <elf.h>
#include <link.h>

#include <cstring>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <vector>

#include "compiler/backend/spirv/shader_cache.h"
#include "compiler/lower/lower.h"
#include "compiler/target/profile.h"

namespace dr::drc {

namespace {

// What the linker says of this very program; empty where it said nothing.
std::string build_id() {
  std::string id;
  dl_iterate_phdr(
      [](dl_phdr_info* info, size_t, void* to) {
        for (size_t k = 0; k < info->dlpi_phnum; ++k) {
          const auto& header = info->dlpi_phdr[k];
          if (header.p_type != PT_NOTE) continue;
          const char* at = reinterpret_cast<const char*>(info->dlpi_addr + header.p_vaddr);
          const char* const end = at + header.p_memsz;
          while (end - at >= static_cast<ptrdiff_t>(sizeof(ElfW(Nhdr)))) {
            ElfW(Nhdr) note;
            std::memcpy(&note, at, sizeof note);
            const auto aligned = [](size_t n) { return (n + 3) / 4 * 4; };
            const char* const name = at + sizeof note;
            const char* const content = name + aligned(note.n_namesz);
            if (note.n_type == NT_GNU_BUILD_ID && note.n_namesz == 4 && std::memcmp(name, "GNU", 4) == 0)
              static_cast<std::string*>(to)->assign(content, note.n_descsz);
            at = content + aligned(note.n_descsz);
          }
        }
        return 1;  // the first object is the program
      },
      &id);
  return id;
}

// So that no two lists of parts give the same text.
void add(std::string& key, const std::string& part) { key += std::to_string(part.size()) + ":" + part; }

std::filesystem::path folder_of(const std::string& file) {
  const std::filesystem::path folder = std::filesystem::path(file).parent_path();
  return folder.empty() ? "." : folder;
}

}  // namespace

BundleCache::BundleCache(const BuildOptions& options) {
  const InputOptions& input = options.input;
  const bool more = options.emit != std::vector<std::string>{"bundle"} || options.passes || options.dump_ir ||
                    options.time_passes || !options.stop_after.empty() || !options.report.empty();
  std::error_code error;
  if (more || !input.compile.shader_cache || input.file == "-" || !input.compile.include_dirs.empty() ||
      !std::filesystem::is_regular_file(input.file, error) || std::filesystem::exists(folder_of(input.file) / "std"))
    return;
  const std::string id = build_id();
  const auto profile = target::load_profile(input.compile.profile);
  std::ifstream file(input.file, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  if (id.empty() || std::holds_alternative<std::string>(profile) || !file) return;
  key_ = "bundle ";
  for (const std::string& part : {id, input.file, text.str(), target::write_profile(std::get<target::Profile>(profile)),
                                  driver::command_line(input.compile)})
    add(key_, part);
  add(key_, "defines");
  for (const std::string& part : input.defines) add(key_, part);
  add(key_, "known");
  for (const std::string& part : input.known) add(key_, part);
}

std::optional<std::string> BundleCache::find() const {
  if (key_.empty()) return std::nullopt;
  const auto words = backend::ShaderCache(backend::default_cache_folder()).find(key_);
  if (!words || words->empty() || words->front() > 4 * (words->size() - 1)) return std::nullopt;
  return std::string(reinterpret_cast<const char*>(words->data() + 1), words->front());
}

void BundleCache::store(const std::string& bundle, const dsl::SourceManager& sources) const {
  if (key_.empty()) return;
  // The program comes first. The consts that -D and the profile give values are part of the key.
  for (uint32_t k = 1; k < sources.size(); ++k) {
    const std::string name(sources.name(dsl::FileId{k}));
    if (!name.starts_with("-D ") && !lower::library_module(name)) return;
  }
  std::vector<uint32_t> words(1 + (bundle.size() + 3) / 4);
  words[0] = static_cast<uint32_t>(bundle.size());
  std::memcpy(words.data() + 1, bundle.data(), bundle.size());
  backend::ShaderCache(backend::default_cache_folder()).store(key_, words);
}

}  // namespace dr::drc
