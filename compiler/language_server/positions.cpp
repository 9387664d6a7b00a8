// SPDX-License-Identifier: Apache-2.0
#include "compiler/language_server/positions.h"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <filesystem>

#include "dsl/source/utf8.h"

namespace dr::language_server {

Lines::Lines(std::string_view text) : text_(text), starts_{0} {
  // The protocol's line ends: \n, \r\n and \r.
  for (size_t at = text.find_first_of("\r\n"); at != std::string_view::npos; at = text.find_first_of("\r\n", at + 1))
    if (text[at] == '\n' || !text.substr(at + 1).starts_with('\n')) starts_.push_back(static_cast<uint32_t>(at + 1));
}

// Without what ends it.
std::string_view Lines::line(uint32_t index) const {
  const size_t end = index + 1 < starts_.size() ? starts_[index + 1] - 1 : text_.size();
  std::string_view line = text_.substr(starts_[index], end - starts_[index]);
  if (index + 1 < starts_.size() && line.ends_with('\r')) line.remove_suffix(1);
  return line;
}

uint32_t Lines::offset(Place place) const {
  if (place.line >= starts_.size()) return static_cast<uint32_t>(text_.size());
  const std::string_view line = this->line(place.line);
  size_t at = 0;
  for (uint32_t units = 0; at < line.size();) {
    const size_t length = std::max(dsl::utf8_length(line, at), size_t{1});
    units += length == 4 ? 2 : 1;
    if (units > place.character) break;
    at += length;
  }
  return starts_[place.line] + static_cast<uint32_t>(at);
}

Place Lines::place(uint32_t offset) const {
  offset = std::min(offset, static_cast<uint32_t>(text_.size()));
  const auto next = std::ranges::upper_bound(starts_, offset);
  const auto index = static_cast<uint32_t>(next - starts_.begin() - 1);
  Place place{index, 0};
  for (size_t at = starts_[index]; at < offset;) {
    const size_t length = std::max(dsl::utf8_length(text_, at), size_t{1});
    place.character += length == 4 ? 2 : 1;
    at += length;
  }
  return place;
}

std::string path_of_uri(std::string_view uri) {
  constexpr std::string_view kScheme = "file://";
  if (!uri.starts_with(kScheme)) return std::string(uri);
  std::string_view rest = uri.substr(kScheme.size());
  rest.remove_prefix(std::min(rest.find('/'), rest.size()));  // the host
  std::string path;
  for (size_t i = 0; i < rest.size(); ++i) {
    unsigned byte = 0;
    if (rest[i] == '%' && i + 2 < rest.size() &&
        std::from_chars(&rest[i + 1], &rest[i + 1] + 2, byte, 16).ptr == &rest[i + 1] + 2) {
      path += static_cast<char>(byte);
      i += 2;
    } else {
      path += rest[i];
    }
  }
  return path;
}

std::string uri_of_path(std::string_view path) {
  if (path.find("://") != std::string_view::npos) return std::string(path);
  std::error_code error;
  const std::string full = std::filesystem::absolute(path, error).lexically_normal().string();
  std::string uri = "file://";
  for (const char c : full) {
    if (std::isalnum(static_cast<unsigned char>(c)) != 0 ||
        std::string_view("/-_.~").find(c) != std::string_view::npos) {
      uri += c;
    } else {
      constexpr std::string_view kDigits = "0123456789ABCDEF";
      const auto byte = static_cast<unsigned char>(c);
      uri += {'%', kDigits[byte >> 4], kDigits[byte & 15]};
    }
  }
  return uri;
}

}  // namespace dr::language_server
