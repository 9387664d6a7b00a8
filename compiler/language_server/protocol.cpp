// SPDX-License-Identifier: Apache-2.0
#include "compiler/language_server/protocol.h"

#include <charconv>

namespace dr::language_server {
namespace {

constexpr size_t kMaxMessage = size_t{256} << 20;
constexpr size_t kMaxHeader = 4096;  // of one line; nobody sends more

// A line without its end. Nothing at the end of the stream.
std::optional<std::string> read_line(std::istream& in) {
  std::string line;
  for (int c = in.get(); c != std::istream::traits_type::eof(); c = in.get()) {
    if (c == '\n') {
      if (line.ends_with('\r')) line.pop_back();
      return line;
    }
    if (line.size() < kMaxHeader) line += static_cast<char>(c);
  }
  return std::nullopt;
}

// Whether brackets lie inside each other so deep that reading them would take a stack of any size.
bool is_too_deep(std::string_view json) {
  constexpr int kMostBrackets = 1000;
  int depth = 0;
  bool in_string = false;
  for (size_t i = 0; i < json.size(); ++i) {
    if (json[i] == '\\' && in_string) {
      ++i;
    } else if (json[i] == '"') {
      in_string = !in_string;
    } else if (!in_string && (json[i] == '[' || json[i] == '{')) {
      if (++depth > kMostBrackets) return true;
    } else if (!in_string && (json[i] == ']' || json[i] == '}')) {
      --depth;
    }
  }
  return false;
}

std::optional<size_t> content_length(std::string_view line) {
  constexpr std::string_view kName = "content-length:";
  if (line.size() < kName.size()) return std::nullopt;
  for (size_t i = 0; i < kName.size(); ++i)
    if (std::tolower(static_cast<unsigned char>(line[i])) != kName[i]) return std::nullopt;
  line.remove_prefix(kName.size());
  while (line.starts_with(' ')) line.remove_prefix(1);
  size_t length = 0;
  const auto [end, error] = std::from_chars(line.data(), line.data() + line.size(), length);
  if (error != std::errc() || length > kMaxMessage) return std::nullopt;
  return length;
}

}  // namespace

std::optional<std::string> read_message(std::istream& in) {
  std::optional<size_t> length;
  while (const auto line = read_line(in)) {
    if (line->empty() && length) {
      std::string body(*length, '\0');
      in.read(body.data(), static_cast<std::streamsize>(body.size()));
      if (static_cast<size_t>(in.gcount()) != body.size()) return std::nullopt;
      return body;
    }
    if (const auto found = content_length(*line)) length = found;
  }
  return std::nullopt;
}

namespace {

// The code unit that stands as `\uXXXX` at a place; 0 where none does.
unsigned escaped_unit(std::string_view text, size_t at) {
  if (text.substr(at, 2) != "\\u" || at + 6 > text.size()) return 0;
  unsigned unit = 0;
  const char* const end = text.data() + at + 6;
  return std::from_chars(text.data() + at + 2, end, unit, 16).ptr == end ? unit : 0;
}

// Editors write half a character where one was typed or cut: U+FFFD is as long, and JSON. So an edit is never lost.
std::string with_whole_characters(std::string text) {
  const auto is_in = [](unsigned unit, unsigned first) { return unit >= first && unit < first + 0x400; };
  for (size_t at = text.find('\\'); at != std::string::npos; at = text.find('\\', at)) {
    const unsigned unit = escaped_unit(text, at);
    if (is_in(unit, 0xd800) && is_in(escaped_unit(text, at + 6), 0xdc00)) {
      at += 12;
    } else {
      if (is_in(unit, 0xd800) || is_in(unit, 0xdc00)) text.replace(at + 2, 4, "fffd");
      at += 2;  // an escaped backslash is no beginning of another escape
    }
  }
  return text;
}

}  // namespace

void write_message(std::ostream& out, const Json& message) {
  // Names of files need not be UTF-8.
  const std::string body = message.dump(-1, ' ', false, Json::error_handler_t::replace);
  out << "Content-Length: " << body.size() << "\r\n\r\n" << body << std::flush;
}

void Inbox::read_all(std::istream& in) {
  bool exit = false;
  while (!exit) {
    const auto text = read_message(in);
    if (!text) break;
    Json message =
        is_too_deep(*text) ? Json(Json::value_t::discarded) : Json::parse(with_whole_characters(*text), nullptr, false);
    const Json method = message.is_object() ? message.value("method", Json()) : Json();
    exit = method == "exit";
    const std::lock_guard lock(mutex_);
    if (method == "$/cancelRequest") {
      const Json params = message.value("params", Json());
      // What was answered before is forgotten with the next thousand.
      constexpr size_t kMost = 1000;
      if (cancelled_.size() >= kMost) cancelled_.clear();
      if (params.is_object() && params.contains("id")) cancelled_.insert(params["id"].dump());
      continue;
    }
    messages_.push_back(std::move(message));
    changed_.notify_one();
  }
  const std::lock_guard lock(mutex_);
  ended_ = true;
  changed_.notify_one();
}

std::optional<Json> Inbox::take(std::optional<std::chrono::milliseconds> wait) {
  std::unique_lock lock(mutex_);
  const auto ready = [&] { return ended_ || !messages_.empty(); };
  if (wait) {
    changed_.wait_for(lock, *wait, ready);
  } else {
    changed_.wait(lock, ready);
  }
  if (messages_.empty()) return std::nullopt;
  Json message = std::move(messages_.front());
  messages_.pop_front();
  return message;
}

bool Inbox::closed() {
  const std::lock_guard lock(mutex_);
  return ended_ && messages_.empty();
}

bool Inbox::waiting() {
  const std::lock_guard lock(mutex_);
  return !messages_.empty();
}

bool Inbox::cancelled(const Json& id) {
  const std::lock_guard lock(mutex_);
  return cancelled_.contains(id.dump());
}

bool Inbox::take_cancelled(const Json& id) {
  const std::lock_guard lock(mutex_);
  return cancelled_.erase(id.dump()) != 0;
}

}  // namespace dr::language_server
