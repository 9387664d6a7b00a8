// SPDX-License-Identifier: Apache-2.0
#include "compiler/io/mesh/gltf/fields.h"

#include <algorithm>
#include <cmath>

#include "compiler/io/file/failure.h"

namespace dr::io::gltf {

std::string Where::text() const {
  if (!parent_) return "the file";
  std::string text = parent_->parent_ ? parent_->text() : std::string();
  if (index_ >= 0) return cat(text, "[", index_, "]");
  return text.empty() ? std::string(key_) : cat(text, ".", key_);
}

std::string found(const Json& value) {
  if (value.is_structured()) return value.type_name();
  return in_quotes(value.dump(-1, ' ', false, Json::error_handler_t::replace));
}

uint64_t to_whole(Json& value, const Where& where) {
  if (value.is_number_unsigned()) return value.get<uint64_t>();
  if (value.is_number_float()) {
    const double number = value.get<double>();
    if (number >= 0 && number <= 9007199254740992.0 && number == std::floor(number)) {
      const auto whole = static_cast<uint64_t>(number);
      value = whole;
      return whole;
    }
  }
  fail(where.text(), ": expected a non-negative integer, found ", found(value));
}

void check_reference(uint64_t index, const char* of, size_t size, const Where& where) {
  if (index >= size) fail(where.text(), ": there is no ", of, "[", index, "], the file has ", size);
}

namespace {

void check_range(double number, double low, double high, const Where& where) {
  if (number >= low && number <= high) return;
  if (low == kAboveZero && number <= 0) fail(where.text(), ": ", number, " is not above 0");
  if (high == kAny) fail(where.text(), ": ", number, " is below ", low);
  fail(where.text(), ": ", number, " is not in ", low == kAboveZero ? 0 : low, " to ", high);
}

}  // namespace

Fields::Fields(Json& value, const Where& where) : value_(value), where_(where) {
  if (!value.is_object()) fail(where.text(), ": expected an object, found ", found(value));
}

Json* Fields::find(const char* key) const {
  const auto it = value_.find(key);
  return it == value_.end() ? nullptr : &*it;
}

Json& Fields::require(const char* key) const {
  Json* value = find(key);
  if (!value) fail(where_.text(), ": ", in_quotes(key), " is missing");
  return *value;
}

std::optional<uint64_t> Fields::whole(const char* key, uint64_t low, uint64_t high) const {
  Json* value = find(key);
  if (!value) return std::nullopt;
  const Where where = where_.at(key);
  const uint64_t number = to_whole(*value, where);
  if (number < low || number > high) {
    if (low == 1 && number == 0) fail(where.text(), ": it is 0");
    fail(where.text(), ": ", number, " is not in ", low, " to ", high);
  }
  return number;
}

uint64_t Fields::required_whole(const char* key, uint64_t low, uint64_t high) const {
  require(key);
  return *whole(key, low, high);
}

std::optional<uint64_t> Fields::code(const char* key, std::span<const uint64_t> codes) const {
  const auto number = whole(key);
  if (!number || std::ranges::find(codes, *number) != codes.end()) return number;
  std::string list;
  for (const uint64_t code : codes) append(list, cat(list.empty() ? "" : ", ", code));
  fail(where_.at(key).text(), ": ", *number, " is not one of ", list);
}

std::optional<double> Fields::number(const char* key, double low, double high) const {
  const Json* value = find(key);
  if (!value) return std::nullopt;
  const Where where = where_.at(key);
  if (!value->is_number()) fail(where.text(), ": expected a number, found ", found(*value));
  const double number = value->get<double>();
  check_range(number, low, high, where);
  return number;
}

void Fields::numbers(const char* key, size_t count, double low, double high) const {
  const Json* value = find(key);
  if (!value) return;
  const Where where = where_.at(key);
  if (!value->is_array() || (count != 0 && value->size() != count)) {
    fail(where.text(), ": expected ", count == 0 ? std::string("a list of") : cat(count), " numbers, found ",
         value->is_array() ? cat(value->size()) : found(*value));
  }
  for (size_t i = 0; i < value->size(); ++i) {
    const Json& item = (*value)[i];
    if (!item.is_number()) fail(where.item(i).text(), ": expected a number, found ", found(item));
    check_range(item.get<double>(), low, high, where.item(i));
  }
}

const std::string* Fields::text(const char* key) const {
  const Json* value = find(key);
  if (!value) return nullptr;
  if (!value->is_string()) fail(where_.at(key).text(), ": expected a string, found ", found(*value));
  return value->get_ptr<const std::string*>();
}

const std::string* Fields::choice(const char* key, std::span<const std::string_view> words) const {
  const std::string* word = text(key);
  if (!word || std::ranges::find(words, *word) != words.end()) return word;
  std::string list;
  for (const std::string_view choice : words) append(list, cat(list.empty() ? "" : ", ", choice));
  fail(where_.at(key).text(), ": ", in_quotes(*word), " is not one of ", list);
}

void Fields::boolean(const char* key) const {
  const Json* value = find(key);
  if (value && !value->is_boolean()) fail(where_.at(key).text(), ": expected a boolean, found ", found(*value));
}

Json* Fields::list(const char* key) const {
  Json* value = find(key);
  if (value && !value->is_array()) fail(where_.at(key).text(), ": expected a list, found ", found(*value));
  return value;
}

std::optional<uint64_t> Fields::reference(const char* key, const char* of, size_t size) const {
  const auto index = whole(key);
  if (index) check_reference(*index, of, size, where_.at(key));
  return index;
}

}  // namespace dr::io::gltf
