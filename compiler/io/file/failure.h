// SPDX-License-Identifier: Apache-2.0
// How the readers and writers of compiler/io fail, and how they word it. Inside, a parser throws `Failure` from
// wherever it finds the fault; the public functions are wrapped in `guarded`, which turns it into a Result. Private to
// compiler/io.
#pragma once

#include <concepts>
#include <cstdint>
#include <exception>
#include <new>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>

#include "compiler/io/file/result.h"

namespace dr::io {

class Failure : public std::exception {
 public:
  explicit Failure(std::string message) : message_(std::move(message)) {}
  const char* what() const noexcept override { return message_.c_str(); }

 private:
  std::string message_;
};

// Text for messages. Numbers are printed without the locale, floats as short as they read back.
void append(std::string& out, std::string_view text);
void append(std::string& out, char character);
void append(std::string& out, double number);
void append_signed(std::string& out, int64_t number);
void append_unsigned(std::string& out, uint64_t number);
template <std::integral T>
requires(!std::same_as<T, char>) void append(std::string& out, T number) {
  if constexpr (std::is_signed_v<T>)
    append_signed(out, number);
  else
    append_unsigned(out, number);
}

template <class... Parts>
std::string cat(const Parts&... parts) {
  std::string out;
  (append(out, parts), ...);
  return out;
}

template <class... Parts>
[[noreturn]] void fail(const Parts&... parts) {
  throw Failure(cat(parts...));
}

// 'text' with what a terminal should not see escaped, and cut when it is longer than a message should hold.
std::string in_quotes(std::string_view text, size_t longest = 60);

// A whole path, in quotes.
std::string path_in_quotes(std::string_view path);

// "1 vertex", "2 vertices".
std::string counted(int64_t count, std::string_view one, std::string_view many);

// The candidate nearest to a misspelled `word`, or nothing when none is near.
std::string_view nearest(std::string_view word, std::span<const std::string_view> candidates);

// " (did you mean 'position'?)", or nothing.
std::string did_you_mean(std::string_view word, std::span<const std::string_view> candidates);

// Runs `work`, which returns T or throws, and gives a Result<T> whose error starts with `prefix`.
template <class Work>
auto guarded(const std::string& prefix, const Work& work) -> Result<std::invoke_result_t<Work>> {
  try {
    if constexpr (std::is_void_v<std::invoke_result_t<Work>>) {
      work();
      return {};
    } else {
      return work();
    }
  } catch (const std::bad_alloc&) {
    return Error{prefix + "not enough memory"};
  } catch (const std::length_error&) {
    return Error{prefix + "not enough memory"};
  } catch (const std::exception& failure) {
    return Error{prefix + failure.what()};
  }
}

}  // namespace dr::io
