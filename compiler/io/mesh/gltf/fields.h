// SPDX-License-Identifier: Apache-2.0
// Fields of JSON objects, each read as one type or refused by its full name. Private to compiler/io; every function
// throws Failure.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "compiler/io/mesh/gltf/container.h"

namespace dr::io::gltf {

inline constexpr double kAny = std::numeric_limits<double>::max();               // as large as it likes
inline constexpr double kAboveZero = std::numeric_limits<double>::denorm_min();  // the least of what must be above 0

// Where a value stands: "meshes[0].primitives[2].attributes". A chain of places on the stack, put in words only when
// something is wrong there, since a file has millions of places.
class Where {
 public:
  Where() = default;  // the root
  Where at(std::string_view key) const { return {this, key, -1}; }
  Where item(size_t index) const { return {this, {}, static_cast<int64_t>(index)}; }
  std::string text() const;  // the root is "the file"

 private:
  Where(const Where* parent, std::string_view key, int64_t index) : parent_(parent), key_(key), index_(index) {}

  const Where* parent_ = nullptr;
  std::string_view key_;
  int64_t index_ = -1;
};

// One object. A field that is absent is nothing, one of a wrong type or out of range is an error.
class Fields {
 public:
  // Fails unless `value` is an object. Precondition: both outlive this.
  Fields(Json& value, const Where& where);

  const Where& where() const { return where_; }
  bool has(const char* key) const { return find(key) != nullptr; }
  Json* find(const char* key) const;
  Json& require(const char* key) const;

  // A number without a fraction, in [low, high]. One that is written as 3.0 is made 3, which every reader understands.
  std::optional<uint64_t> whole(const char* key, uint64_t low = 0, uint64_t high = UINT64_MAX) const;
  uint64_t required_whole(const char* key, uint64_t low = 0, uint64_t high = UINT64_MAX) const;
  // One of the numbers.
  std::optional<uint64_t> code(const char* key, std::span<const uint64_t> codes) const;
  std::optional<double> number(const char* key, double low, double high) const;
  // A list of `count` numbers (any, when 0), each in [low, high].
  void numbers(const char* key, size_t count, double low, double high) const;
  const std::string* text(const char* key) const;
  const std::string* choice(const char* key, std::span<const std::string_view> words) const;
  void boolean(const char* key) const;
  // The list under `key`, or nullptr.
  Json* list(const char* key) const;
  // An index into the list `of` at the root, which has `size` items.
  std::optional<uint64_t> reference(const char* key, const char* of, size_t size) const;

 private:
  Json& value_;
  const Where& where_;
};

// The number at `where` without a fraction.
uint64_t to_whole(Json& value, const Where& where);
void check_reference(uint64_t index, const char* of, size_t size, const Where& where);
// What stands there, for messages.
std::string found(const Json& value);

}  // namespace dr::io::gltf
