// SPDX-License-Identifier: Apache-2.0
// A value or the reason why there is none. What compiler/io returns: whatever a file or a user's text may do wrong
// comes back as one sentence, never as an exception.
#pragma once

#include <cassert>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <variant>

namespace dr::io {

// What an error is about: what was given and asked for, or the device or machine that is to do it (there is none, it
// has no memory, it was lost, it has a limit).
enum class Blame : uint8_t { Given, Device };

// Lower case, one sentence, no full stop; it opens with the file or the text it speaks of.
struct Error {
  std::string message;
  Blame blame = Blame::Given;
};

template <class T>
class [[nodiscard]] Result {
 public:
  Result(T value) : state_(std::in_place_index<0>, std::move(value)) {}
  Result(Error error) : state_(std::in_place_index<1>, std::move(error)) {}

  bool ok() const { return state_.index() == 0; }
  explicit operator bool() const { return ok(); }

  // Preconditions: value() needs ok(), error() and blame() need !ok().
  const T& value() const& { return assert(ok()), std::get<0>(state_); }
  T& value() & { return assert(ok()), std::get<0>(state_); }
  T&& value() && { return assert(ok()), std::move(std::get<0>(state_)); }
  const T& operator*() const& { return value(); }
  T& operator*() & { return value(); }
  T&& operator*() && { return std::move(*this).value(); }
  const T* operator->() const { return &value(); }
  T* operator->() { return &value(); }
  const std::string& error() const { return assert(!ok()), std::get<1>(state_).message; }
  Blame blame() const { return assert(!ok()), std::get<1>(state_).blame; }

 private:
  std::variant<T, Error> state_;
};

template <>
class [[nodiscard]] Result<void> {
 public:
  Result() = default;
  Result(Error error) : error_(std::move(error)) {}

  bool ok() const { return !error_.has_value(); }
  explicit operator bool() const { return ok(); }
  const std::string& error() const { return assert(!ok()), error_->message; }
  Blame blame() const { return assert(!ok()), error_->blame; }

 private:
  std::optional<Error> error_;
};

}  // namespace dr::io
