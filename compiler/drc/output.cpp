// SPDX-License-Identifier: Apache-2.0
// Writing products of the commands.
#include "compiler/drc/output.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <optional>

#include "compiler/drc/input.h"

namespace dr::drc {
namespace {

namespace fs = std::filesystem;

bool write_to(const fs::path& file, std::string_view content) {
  std::ofstream out(file, std::ios::binary | std::ios::trunc);
  out.write(content.data(), static_cast<std::streamsize>(content.size()));
  out.close();
  return static_cast<bool>(out);
}

// A reader of the file, or an interruption, must never meet half of it: the content goes to a file beside it, which
// then takes its name.
bool replace(const fs::path& file, std::string_view content) {
  const fs::path temporary = file.string() + ".new";
  std::error_code error;
  if (write_to(temporary, content)) {
    fs::rename(temporary, file, error);
    if (!error) return true;
  }
  fs::remove(temporary, error);
  return false;
}

// A link is written through.
fs::path behind_links(const std::string& file) {
  std::error_code error;
  if (!fs::is_symlink(file, error)) return file;
  const fs::path resolved = fs::weakly_canonical(file, error);
  return error ? fs::path(file) : resolved;
}

// From the start of an open file, which is not emptied before and ends with the content.
bool write_whole(int file, std::string_view content) {
  size_t written = 0;
  while (written < content.size()) {
    const ssize_t count = pwrite(file, content.data() + written, content.size() - written, static_cast<off_t>(written));
    if (count <= 0) return false;
    written += static_cast<size_t>(count);
  }
  return ftruncate(file, static_cast<off_t>(content.size())) == 0;
}

// A file of the content beside another one, under a name that nothing has; whether it has that one's owner and mode,
// too. Nothing where there is no room for it, or the folder takes none.
struct Copy {
  fs::path file;
  bool is_alike = false;
};

std::optional<Copy> copy_beside(const fs::path& file, const struct stat& like, std::string_view content) {
  std::string name = file.string() + ".XXXXXX";
  const int out = mkstemp(name.data());
  if (out < 0) return std::nullopt;
  struct stat made {};
  const bool is_owned = fstat(out, &made) == 0 && made.st_uid == like.st_uid && made.st_gid == like.st_gid;
  const bool is_alike =
      (is_owned || fchown(out, like.st_uid, like.st_gid) == 0) && fchmod(out, like.st_mode & 07777) == 0;
  const bool written = write_whole(out, content) && fsync(out) == 0;
  if (close(out) == 0 && written) return Copy{name, is_alike};
  unlink(name.c_str());
  return std::nullopt;
}

}  // namespace

bool rewrite_file(const std::string& file, std::string_view before, std::string_view content) {
  const fs::path target = behind_links(file);
  struct stat status {};
  if (stat(target.c_str(), &status) != 0 || !S_ISREG(status.st_mode)) return write_product(file, content);
  const auto copy = copy_beside(target, status, content);
  if (copy && copy->is_alike && status.st_nlink == 1 && rename(copy->file.c_str(), target.c_str()) == 0) return true;
  // The file has another name, or an owner that nobody else can give: it is written itself. What was in it is written
  // back if that fails, and the copy stays if that fails, too.
  const int out = open(target.c_str(), O_WRONLY | O_CLOEXEC);
  const bool written = out >= 0 && write_whole(out, content);
  const bool lost = out >= 0 && !written && !write_whole(out, before);
  if (out >= 0) close(out);
  if (copy && !lost) unlink(copy->file.c_str());
  if (written) return true;
  print_error("cannot write '" + file + "'" + (lost && copy ? ": its text is in '" + copy->file.string() + "'" : ""));
  return false;
}

bool write_product(const std::string& file, std::string_view content) {
  if (file == "-") {
    const bool written =
        std::fwrite(content.data(), 1, content.size(), stdout) == content.size() && std::fflush(stdout) == 0;
    if (!written) print_error("cannot write to stdout");
    return written;
  }
  // What is no regular file (a device, a pipe) must stay what it is: renaming over it would put a file in its place.
  std::error_code error;
  const fs::path target = behind_links(file);
  const fs::file_status status = fs::status(target, error);
  const bool replaceable = status.type() == fs::file_type::not_found || status.type() == fs::file_type::regular;
  if (replaceable ? replace(target, content) : write_to(target, content)) return true;
  print_error("cannot write '" + file + "'");
  return false;
}

}  // namespace dr::drc
