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

namespace {

constexpr std::string_view kFile = "file://";

std::string decoded(std::string_view text) {
  std::string out;
  for (size_t i = 0; i < text.size(); ++i) {
    unsigned byte = 0;
    if (text[i] == '%' && i + 2 < text.size() &&
        std::from_chars(&text[i + 1], &text[i + 1] + 2, byte, 16).ptr == &text[i + 1] + 2) {
      out += static_cast<char>(byte);
      i += 2;
    } else {
      out += text[i];
    }
  }
  return out;
}

}  // namespace

bool is_file_uri(std::string_view uri) { return uri.starts_with(kFile); }

std::string path_of_uri(std::string_view uri) {
  if (!is_file_uri(uri)) return std::string(uri.substr(uri.rfind('/') + 1));
  const std::string_view rest = uri.substr(kFile.size());
  const size_t path = std::min(rest.find('/'), rest.size());
  const std::string_view host = rest.substr(0, path);
  const bool is_here = host.empty() || host == "localhost";
  return (is_here ? "" : "//" + std::string(host)) + decoded(rest.substr(path));
}

std::string whole_path(std::string_view path) {
  // Of another host: the standard library would drop a slash.
  const bool has_host = path.starts_with("//") && !path.starts_with("///");
  std::error_code error;
  const std::string whole = std::filesystem::absolute(path, error).lexically_normal().string();
  return has_host && !whole.starts_with("//") ? "/" + whole : whole;
}

std::string uri_of_path(std::string_view path) {
  const std::string whole = whole_path(path);
  std::string uri(whole.starts_with("//") ? kFile.substr(0, kFile.size() - 2) : kFile);
  for (const char c : whole) {
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
