// SPDX-License-Identifier: Apache-2.0
// JSON literals: numbers and bools in nested lists, whose depth and lengths are the shape.

#include <array>
#include <limits>
#include <nlohmann/json.hpp>
#include <span>
#include <string>
#include <vector>

#include "compiler/io/array/checked.h"
#include "compiler/io/array/npy.h"
#include "compiler/io/file/failure.h"

namespace dr::io {
namespace {

using Json = nlohmann::json;

constexpr size_t kMaxDepth = 4;  // layers, height, width, components
constexpr size_t kMaxText = size_t{16} << 20;

class LiteralReader {
 public:
  Array read(const Json& root, int expected_components) {
    walk(root, 0, "the literal");
    const Extent extent = extent_of_shape(std::span(sides_).first(depth_), expected_components);
    const bool all_bools = bools_ == values_.size();
    if (bools_ != 0 && !all_bools) fail("true and false do not mix with numbers");
    const ElementKind kind = all_bools ? ElementKind::Bool : integers_ ? ElementKind::Int32 : ElementKind::Float64;
    Array array = checked_zeros(kind, extent.components, extent.width, extent.height, extent.layers);
    for (size_t i = 0; i < values_.size(); ++i) {
      switch (kind) {
        case ElementKind::Bool: array.bytes[i] = std::byte{values_[i] != 0}; break;
        case ElementKind::Int32: array.as<int32_t>()[i] = static_cast<int32_t>(values_[i]); break;
        case ElementKind::Float64: array.as<double>()[i] = values_[i]; break;
        case ElementKind::Float32:
        case ElementKind::UInt32: break;
      }
    }
    return array;
  }

 private:
  // The first value of each depth sets the length that all others must have; the first number sets the depth.
  void walk(const Json& value, size_t depth, const std::string& where) {
    if (value.is_array()) {
      if (closed_ && depth >= depth_) fail(where, " is a list, expected a number as before it");
      if (depth >= kMaxDepth) fail("lists are nested deeper than ", kMaxDepth);
      if (depth == depth_) sides_[depth_++] = static_cast<int64_t>(value.size());
      if (static_cast<int64_t>(value.size()) != sides_[depth]) {
        fail(where, " has ", value.size(), " items, expected ", sides_[depth], " as in the list before it");
      }
      for (size_t i = 0; i < value.size(); ++i) walk(value[i], depth + 1, item_name(where, depth, i));
      return;
    }
    closed_ = true;
    if (depth != depth_) fail(where, " is not a list, expected one as before it");
    if (value.is_boolean()) {
      ++bools_;
      values_.push_back(value.get<bool>() ? 1 : 0);
    } else if (value.is_number()) {
      const double number = value.get<double>();
      integers_ = integers_ && value.is_number_integer() && number >= std::numeric_limits<int32_t>::min() &&
                  number <= std::numeric_limits<int32_t>::max();
      values_.push_back(number);
    } else {
      fail(where, " is ",
           value.is_null()     ? "null"
           : value.is_string() ? "a string"
                               : "an object",
           ", expected a number, true or false");
    }
  }

  static std::string item_name(const std::string& where, size_t depth, size_t index) {
    return cat(depth == 0 ? std::string("item ") : where + ", ", index);
  }

  std::array<int64_t, kMaxDepth> sides_{};  // of the lists, outermost first
  size_t depth_ = 0;                        // how many of them are known
  bool closed_ = false;                     // a number was seen, so the depth is known
  std::vector<double> values_;
  size_t bools_ = 0;
  bool integers_ = true;
};

}  // namespace

Array parse_literal(std::string_view text, int expected_components) {
  if (text.size() > kMaxText) fail("it has ", text.size(), " characters, the limit is ", kMaxText, "; use a .npy file");
  const auto check_depth = [](int depth, Json::parse_event_t, Json&) {
    if (depth > static_cast<int>(kMaxDepth)) fail("lists are nested deeper than ", kMaxDepth);
    return true;
  };
  Json root;
  try {
    root = Json::parse(text.begin(), text.end(), check_depth);
  } catch (const Json::parse_error& error) {
    fail("character ", error.byte, ": not valid JSON");
  } catch (const Json::exception&) {
    fail("a number does not fit a double");
  }
  return LiteralReader().read(root, expected_components);
}

}  // namespace dr::io
