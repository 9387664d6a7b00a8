// SPDX-License-Identifier: Apache-2.0
#include "compiler/io/mesh/gltf/uri.h"

#include <algorithm>
#include <filesystem>
#include <system_error>

#include "compiler/io/file/failure.h"
#include "compiler/io/mesh/gltf/container.h"

namespace dr::io::gltf {
namespace {

namespace fs = std::filesystem;

// The file that a relative URI names, which must lie in the folder of the glTF file.
std::string resolve_uri(const std::string& uri, const std::string& gltf_path, const std::string& where) {
  std::string name;
  for (size_t i = 0; i < uri.size(); ++i) {
    if (uri[i] != '%') {
      name += uri[i];
      continue;
    }
    const auto digit = [&](size_t at) -> int {
      if (at >= uri.size()) return -1;
      const char c = uri[at];
      if (c >= '0' && c <= '9') return c - '0';
      if (c >= 'a' && c <= 'f') return c - 'a' + 10;
      if (c >= 'A' && c <= 'F') return c - 'A' + 10;
      return -1;
    };
    const int high = digit(i + 1);
    const int low = digit(i + 2);
    if (high < 0 || low < 0) fail(where, ": ", in_quotes(uri), " has a bad % escape");
    name += static_cast<char>(high * 16 + low);
    i += 2;
  }
  const auto refuse = [&](std::string_view why) { fail(where, ": ", in_quotes(uri), " ", why); };
  if (name.empty()) refuse("names no file");
  if (name.find('\0') != std::string::npos) refuse("holds a zero byte");
  if (name.find('\\') != std::string::npos) refuse("holds a backslash");
  if (const size_t colon = name.find(':'); colon != std::string::npos && colon < name.find('/')) {
    refuse("has a scheme, only 'data:' and files in the folder of the glTF file are read");
  }
  const fs::path relative(name);
  const bool climbs = std::find(relative.begin(), relative.end(), fs::path("..")) != relative.end();
  if (relative.is_absolute() || climbs) refuse("leads out of the folder of the glTF file");

  // A link may lead out too.
  fs::path folder = fs::path(gltf_path).parent_path();
  if (folder.empty()) folder = ".";
  std::error_code error;
  const fs::path base = fs::weakly_canonical(folder, error);
  if (error) refuse(error.message());
  const fs::path full = fs::weakly_canonical(folder / relative, error);
  if (error) refuse(error.message());
  const auto [end, ignored] = std::mismatch(base.begin(), base.end(), full.begin(), full.end());
  if (end != base.end()) refuse("leads out of the folder of the glTF file");
  return full.string();
}

}  // namespace

Bytes load_uri(const std::string& uri, const std::string& gltf_path, const std::string& where) {
  if (uri.starts_with("data:")) {
    const size_t comma = uri.find(',');
    if (comma == std::string::npos) fail(where, ": there is no ',' after 'data:'");
    const std::string_view header = std::string_view(uri).substr(5, comma - 5);
    if (!header.ends_with(";base64")) fail(where, ": a data URI must be base64, found ", in_quotes(header));
    return decode_base64(std::string_view(uri).substr(comma + 1), where);
  }
  const std::string file = resolve_uri(uri, gltf_path, where);
  try {
    return read_file(file);
  } catch (const Failure& failure) {
    fail(where, ": cannot read ", in_quotes(uri), ": ", failure.what());
  }
}

}  // namespace dr::io::gltf
