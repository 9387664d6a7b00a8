// SPDX-License-Identifier: Apache-2.0
#include "runtime/drun/out_folder.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <filesystem>
#include <string_view>
#include <system_error>

#include "compiler/io/results.h"
#include "runtime/drun/checkpoint.h"
#include "runtime/drun/target.h"

namespace dr::drun {

namespace fs = std::filesystem;

namespace {

bool is_number(std::string_view text) {
  return !text.empty() && text.find_first_not_of("0123456789") == std::string_view::npos;
}

// "checkpoint-7", with what save_checkpoint() puts there and nothing else: others have folders of such names, too.
bool is_checkpoint(const fs::path& folder) {
  const std::string name = folder.filename().string();
  std::error_code error;
  if (!name.starts_with(kCheckpoint) || !is_number(std::string_view(name).substr(kCheckpoint.size()))) return false;
  if (fs::is_symlink(folder, error) || !fs::is_directory(folder, error)) return false;
  for (const auto& entry : fs::directory_iterator(folder, error)) {
    const std::string file = entry.path().filename().string();
    const bool is_own =
        file.ends_with(".npy") || file.ends_with(".tmp") || file == "log.jsonl" || file == "log.jsonl.partial";
    if (!entry.is_regular_file(error) || !is_own) return false;
  }
  return !error;
}

// "img.npy.1234567.tmp", as compiler/io writes files before it names them, and what write_text() begins with.
bool is_temporary(std::string_view name) {
  if (name == "checkpoint.json.partial") return true;
  if (!name.ends_with(".tmp")) return false;
  name.remove_suffix(4);
  const size_t dot = name.rfind('.');
  if (dot == std::string_view::npos || !is_number(name.substr(dot + 1))) return false;
  name = name.substr(0, dot);
  return name.ends_with(".npy") || name.ends_with(".png");
}

}  // namespace

OutFolder::~OutFolder() {
  if (descriptor_ >= 0) close(descriptor_);  // and lets go of it
}

void OutFolder::take() {
  if (path_.empty() || descriptor_ >= 0) return;
  must(io::make_results_folder(path_));
  descriptor_ = open(path_.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (descriptor_ < 0)
    throw Mistake{"cannot open the folder '" + path_ + "': " + std::generic_category().message(errno)};
  if (flock(descriptor_, LOCK_EX | LOCK_NB) != 0 && errno == EWOULDBLOCK)
    throw Mistake{"another drun writes to '" + path_ + "': wait for it, or give another folder with --out"};
}

void OutFolder::sweep(const std::string& in_use) const {
  if (path_.empty()) return;
  std::error_code error;
  std::vector<fs::path> left;
  for (const auto& entry : fs::directory_iterator(path_, error)) {
    const std::string name = entry.path().filename().string();
    if (is_temporary(name) || (name != in_use && is_checkpoint(entry.path()))) left.push_back(entry.path());
  }
  for (const fs::path& path : left) fs::remove_all(path, error);
}

void sync_to_disk(const std::string& path) {
  const int descriptor = open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (descriptor < 0) return;
  // A file system that cannot (EINVAL) is no reason to stop; a disk that failed is.
  const int error = fsync(descriptor) != 0 ? errno : 0;
  close(descriptor);
  if (error == EIO || error == ENOSPC || error == EDQUOT)
    throw Mistake{"cannot write '" + path + "' to the disk: " + std::generic_category().message(error)};
}

}  // namespace dr::drun
