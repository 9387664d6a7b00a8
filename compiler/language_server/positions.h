// SPDX-License-Identifier: Apache-2.0
// Places as the Language Server Protocol counts them: lines and UTF-16 units from 0, and files as URIs.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace dr::language_server {

struct Place {
  uint32_t line = 0;
  uint32_t character = 0;
};

// Where the lines of a text begin.
class Lines {
 public:
  explicit Lines(std::string_view text);

  // What lies behind the end of a line or of the text is its end. Bytes that are not UTF-8 count as one unit each.
  uint32_t offset(Place place) const;
  Place place(uint32_t offset) const;

 private:
  std::string_view line(uint32_t index) const;

  std::string_view text_;
  std::vector<uint32_t> starts_;
};

// file:///a%20b.dr <-> /a b.dr, file://host/a.dr <-> //host/a.dr. What is no file, as `untitled:Untitled-1` and what
// stands in a repository, has its last part as a name: it lies in no folder.
bool is_file_uri(std::string_view uri);
std::string path_of_uri(std::string_view uri);
std::string uri_of_path(std::string_view path);
// From the root on, without `.` and `..`.
std::string whole_path(std::string_view path);

}  // namespace dr::language_server
