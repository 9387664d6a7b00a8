// SPDX-License-Identifier: Apache-2.0
// Literals, names and indentation of generated GLSL.
#include "compiler/backend/glsl/text.h"

#include <array>
#include <bit>
#include <cctype>
#include <charconv>
#include <cmath>
#include <map>
#include <mutex>
#include <unordered_map>

#include "compiler/backend/bundle/bundle.h"

namespace dr::backend::glsl {

void Writer::line(std::string_view text) {
  if (!text.empty() && text.front() == '}') --depth_;
  if (!text.empty()) {
    out_.append(static_cast<size_t>(std::max(depth_, 0)) * 2, ' ');
    out_ += text;
  }
  out_ += '\n';
  if (!text.empty() && text.back() == '{') ++depth_;
}

std::string symbol_name(std::string_view symbol) {
  // Two underscores in a row are reserved: where they occur, each is written "u_".
  const bool doubled = symbol.find("__") != std::string_view::npos || symbol.starts_with('_');
  std::string out = "ext_";
  for (char c : symbol) out += doubled && c == '_' ? std::string("u_") : std::string(1, c);
  if (out.ends_with('_')) out += 'u';
  return out;
}

namespace {

// By name. Each is kept as long as the process lives, as extents are.
struct Divisions {
  std::mutex mutex;
  std::map<std::string, ir::Dim, std::less<>> known;
};
Divisions& divisions() {
  static Divisions all;
  return all;
}

// Not to be taken for a name of a program's, which ends in an underscore and digits (without_names).
constexpr std::string_view kDivision = "divided_x";

}  // namespace

std::string division_name(const ir::Dim& division) {
  const std::string text = division.str();
  char hex[16];
  const auto end = std::to_chars(hex, hex + sizeof hex, bundle::checksum(text.data(), text.size()), 16).ptr;
  std::string name = std::string(kDivision) + std::string(hex, end);
  const std::scoped_lock lock(divisions().mutex);
  divisions().known.emplace(name, division);
  return name;
}

std::vector<ir::Dim> host_divisions(std::string_view text) {
  std::map<std::string, ir::Dim, std::less<>> found;
  const std::scoped_lock lock(divisions().mutex);
  for (size_t at = text.find(kDivision); at != std::string_view::npos; at = text.find(kDivision, at + 1)) {
    const size_t end = std::min(text.find_first_not_of("0123456789abcdef", at + kDivision.size()), text.size());
    if (const auto it = divisions().known.find(text.substr(at, end - at)); it != divisions().known.end())
      found.insert(*it);
  }
  std::vector<ir::Dim> out;
  for (const auto& entry : found) out.push_back(entry.second);
  return out;
}

std::string dim_expression(const ir::Dim& dim) {
  std::map<std::string, ir::Dim, std::less<>> names;
  for (const std::string& s : dim.symbols())
    if (symbol_name(s) != s) names.emplace(s, ir::Dim::symbol(symbol_name(s)));
  const ir::Dim narrow = dim.with_wide_divisions(division_name);
  const std::string text = (names.empty() ? narrow : narrow.substitute(names)).str();
  return narrow.is_constant() || narrow.as_symbol() ? text : "(" + text + ")";
}

namespace {

std::string float_literal(double value) {
  const float f = static_cast<float>(value);
  if (!std::isfinite(f)) {
    char hex[16];
    const auto end = std::to_chars(hex, hex + sizeof hex, std::bit_cast<uint32_t>(f), 16).ptr;
    return "uintBitsToFloat(0x" + std::string(hex, end) + "u)";
  }
  std::array<char, 32> text{};
  const auto end = std::to_chars(text.data(), text.data() + text.size(), f).ptr;
  std::string out(text.data(), end);
  if (out.find_first_of(".e") == std::string::npos) out += ".0";
  return std::signbit(f) ? "(" + out + ")" : out;
}

std::string scalar_literal(ir::Scalar scalar, double value) {
  switch (scalar) {
    case ir::Scalar::Bool: return value != 0 ? "true" : "false";
    case ir::Scalar::Uint: return std::to_string(static_cast<uint32_t>(value)) + "u";
    case ir::Scalar::Int: {
      const auto i = static_cast<int32_t>(value);
      if (i == INT32_MIN) return "(-2147483647 - 1)";
      return i < 0 ? "(" + std::to_string(i) + ")" : std::to_string(i);
    }
    case ir::Scalar::Float: break;
  }
  return float_literal(value);
}

}  // namespace

std::string literal(const ir::Type& type, std::span<const double> components, std::string_view zero) {
  const auto scalar = [&](double x) {
    if (zero.empty() || static_cast<float>(x) != 0) return scalar_literal(type.scalar, x);
    return std::signbit(x) ? "(-" + std::string(zero) + ")" : std::string(zero);
  };
  if (type.is_scalar()) return scalar(components[0]);
  std::string out = type.str() + "(";
  for (size_t k = 0; k < components.size(); ++k) out += (k ? ", " : "") + scalar(components[k]);
  return out + ")";
}

std::string zero(const ir::Type& type) {
  if (type.is_matrix()) return type.str() + "(0.0)";
  const std::string s = scalar_literal(type.scalar, 0);
  return type.is_scalar() ? s : type.str() + "(" + s + ")";
}

std::string limit(const ir::Type& type, bool least) {
  std::string one = least ? "uintBitsToFloat(0x7f800000u)" : "uintBitsToFloat(0xff800000u)";
  if (type.scalar == ir::Scalar::Int) one = least ? "2147483647" : "(-2147483647 - 1)";
  if (type.scalar == ir::Scalar::Uint) one = least ? "4294967295u" : "0u";
  return type.is_scalar() ? one : type.str() + "(" + one + ")";
}

std::string component(const ir::Type& type, const std::string& name, int c) {
  if (type.is_scalar()) return name;
  if (type.is_matrix()) return name + "[" + std::to_string(c / type.rows) + "][" + std::to_string(c % type.rows) + "]";
  return name + "[" + std::to_string(c) + "]";
}

std::string storage_scalar(ir::Scalar scalar) {
  switch (scalar) {
    case ir::Scalar::Float: return "float";
    case ir::Scalar::Int: return "int";
    case ir::Scalar::Uint:
    case ir::Scalar::Bool: break;
  }
  return "uint";
}

std::string sanitize(std::string_view name) {
  std::string out;
  for (char c : name) {
    const bool fine = std::isalnum(static_cast<unsigned char>(c)) != 0;
    if (fine)
      out += c;
    else if (!out.empty() && out.back() != '_')
      out += '_';  // two underscores in a row are reserved
  }
  while (!out.empty() && out.back() == '_') out.pop_back();
  if (out.empty() || std::isalpha(static_cast<unsigned char>(out.front())) == 0) out.insert(out.begin(), 'v');
  return out;
}

std::string without_names(std::string_view source) {
  const auto is_word = [](char c) { return c == '_' || std::isalnum(static_cast<unsigned char>(c)) != 0; };
  const auto is_digit = [](char c) { return c >= '0' && c <= '9'; };
  const auto is_numbered = [&](std::string_view word) {
    constexpr std::string_view kBlock = "_block";
    if (word.ends_with(kBlock)) word.remove_suffix(kBlock.size());
    const size_t last = word.find_last_not_of("0123456789");
    return last != std::string_view::npos && last + 1 < word.size() && word[last] == '_';
  };
  std::unordered_map<std::string_view, size_t> numbers;
  std::string out;
  out.reserve(source.size());
  for (size_t at = 0; at < source.size();) {
    size_t end = at + 1;
    const bool directive = source[at] == '#';
    if (directive) {
      end = std::min(source.find('\n', at), source.size());
    } else if (is_word(source[at])) {
      while (end < source.size() && is_word(source[end])) ++end;
    }
    const std::string_view word = source.substr(at, end - at);
    const bool member = at > 0 && source[at - 1] == '.';
    if (!directive && !member && !is_digit(word.front()) && is_numbered(word))
      out += "_" + std::to_string(numbers.emplace(word, numbers.size()).first->second);
    else
      out += word;
    at = end;
  }
  return out;
}

}  // namespace dr::backend::glsl
