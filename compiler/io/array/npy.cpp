// SPDX-License-Identifier: Apache-2.0
// .npy files, and the rule by which a shape becomes an extent.

#include "compiler/io/array/npy.h"

#include <algorithm>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>
#include <string>

#include "compiler/io/array/checked.h"
#include "compiler/io/file/failure.h"

namespace dr::io {
namespace {

// The header is a Python dict literal; this reads the three entries that NumPy writes and nothing else.
struct Header {
  std::string descr;
  bool fortran_order = false;
  std::vector<int64_t> shape;
};

class HeaderReader {
 public:
  // `start` is the byte of the file at which the text begins.
  HeaderReader(std::string_view text, size_t start) : text_(text), start_(start) {}

  Header read() {
    Header header;
    bool has_descr = false;
    bool has_order = false;
    bool has_shape = false;
    expect('{');
    while (!accept('}')) {
      const std::string key = string();
      expect(':');
      if (key == "descr" && !has_descr) {
        skip_blanks();
        if (at_ < text_.size() && text_[at_] == '[') fail_here("records are not read, only one scalar type");
        header.descr = string();
        has_descr = true;
      } else if (key == "fortran_order" && !has_order) {
        header.fortran_order = boolean();
        has_order = true;
      } else if (key == "shape" && !has_shape) {
        header.shape = shape();
        has_shape = true;
      } else {
        fail_here("unexpected key ", in_quotes(key));
      }
      if (!accept(',')) {
        expect('}');
        break;
      }
    }
    skip_blanks();
    if (at_ != text_.size()) fail_here("unexpected text after the header");
    if (!has_descr || !has_order || !has_shape) fail_here("the header lacks 'descr', 'fortran_order' or 'shape'");
    return header;
  }

 private:
  template <class... Parts>
  [[noreturn]] void fail_here(const Parts&... parts) const {
    fail("byte ", start_ + at_, ": ", parts...);
  }

  void skip_blanks() {
    while (at_ < text_.size() && (text_[at_] == ' ' || text_[at_] == '\n')) ++at_;
  }
  bool accept(char c) {
    skip_blanks();
    if (at_ >= text_.size() || text_[at_] != c) return false;
    ++at_;
    return true;
  }
  void expect(char c) {
    if (!accept(c)) fail_here("expected '", c, "' in the header");
  }
  std::string string() {
    skip_blanks();
    const char quote = at_ < text_.size() ? text_[at_] : '\0';
    if (quote != '\'' && quote != '"') fail_here("expected a string in the header");
    const size_t end = text_.find(quote, at_ + 1);
    if (end == std::string_view::npos) fail_here("a string of the header does not end");
    std::string value(text_.substr(at_ + 1, end - at_ - 1));
    at_ = end + 1;
    return value;
  }
  bool boolean() {
    skip_blanks();
    for (const bool value : {true, false}) {
      const std::string_view word = value ? "True" : "False";
      if (text_.substr(at_).starts_with(word)) {
        at_ += word.size();
        return value;
      }
    }
    fail_here("expected True or False");
  }
  std::vector<int64_t> shape() {
    std::vector<int64_t> result;
    expect('(');
    while (!accept(')')) {
      skip_blanks();
      int64_t value = 0;
      const auto [end, error] = std::from_chars(text_.data() + at_, text_.data() + text_.size(), value);
      if (error != std::errc() || value < 0) fail_here("expected a dimension");
      at_ = static_cast<size_t>(end - text_.data());
      result.push_back(value);
      if (result.size() > 32) fail_here("more than 32 dimensions");
      if (!accept(',')) {
        expect(')');
        break;
      }
    }
    return result;
  }

  std::string_view text_;
  size_t start_;
  size_t at_ = 0;
};

float half_to_float(uint16_t half) {
  const int exponent = half >> 10 & 31;
  const int mantissa = half & 1023;
  float value = 0;
  if (exponent == 31) {
    value = mantissa != 0 ? std::numeric_limits<float>::quiet_NaN() : std::numeric_limits<float>::infinity();
  } else if (exponent == 0) {
    value = std::ldexp(static_cast<float>(mantissa), -24);
  } else {
    value = std::ldexp(static_cast<float>(mantissa + 1024), exponent - 25);
  }
  return (half & 0x8000) != 0 ? -value : value;
}

// Scalar `i` of `size` bytes as an unsigned number, in either byte order.
uint64_t load(std::span<const uint8_t> data, size_t i, size_t size, bool big_endian) {
  uint64_t value = 0;
  for (size_t k = 0; k < size; ++k) {
    const size_t byte = big_endian ? size - 1 - k : k;
    value |= static_cast<uint64_t>(data[i * size + byte]) << (8 * k);
  }
  return value;
}

ElementKind kind_of_descr(const std::string& descr) {
  const char letter = descr.size() == 3 ? descr[1] : '\0';
  const char digit = descr.size() == 3 ? descr[2] : '\0';
  const char order = descr.size() == 3 ? descr[0] : '\0';
  const bool known_order = order == '<' || order == '>' || (order == '|' && digit == '1');
  if (known_order) {
    if (letter == 'f' && (digit == '2' || digit == '4')) return ElementKind::Float32;
    if (letter == 'f' && digit == '8') return ElementKind::Float64;
    if (letter == 'b' && digit == '1') return ElementKind::Bool;
    if (digit == '1' || digit == '2' || digit == '4' || digit == '8') {
      if (letter == 'i') return ElementKind::Int32;
      if (letter == 'u') return ElementKind::UInt32;
    }
  }
  fail("the scalar type ", in_quotes(descr), " is not read, expected floats (f2, f4, f8), integers or bools");
}

template <class T>
void put(Array& array, size_t i, T value) {
  std::memcpy(array.bytes.data() + i * sizeof(T), &value, sizeof(T));
}

// Whether integers of 64 bits are none below 0, and some a uint32's alone.
bool fits_unsigned(std::span<const uint8_t> data, bool big_endian) {
  uint64_t most = 0;
  for (size_t i = 0; i < data.size() / 8; ++i) most = std::max(most, load(data, i, 8, big_endian));
  return most > std::numeric_limits<int32_t>::max() && most <= std::numeric_limits<uint32_t>::max();
}

}  // namespace

std::string shape_text(std::span<const int64_t> shape) {
  std::string text = "(";
  for (size_t i = 0; i < shape.size(); ++i) {
    if (i > 0) text += ", ";
    append(text, shape[i]);
  }
  return text + (shape.size() == 1 ? ",)" : ")");
}

Extent extent_of_shape(std::span<const int64_t> shape, int expected_components) {
  for (const int64_t side : shape) {
    if (side <= 0) fail("shape ", shape_text(shape), " has no elements");
  }
  const bool last_is_components =
      !shape.empty() && ((expected_components > 1 && shape.back() == expected_components) ||
                         (shape.size() == 4 && (expected_components == 0 || shape.back() == expected_components)));
  Extent extent;
  std::span<const int64_t> sides = shape;
  if (last_is_components) {
    if (shape.back() > 1024) fail("shape ", shape_text(shape), " would have ", shape.back(), " components");
    extent.components = static_cast<int>(shape.back());
    sides = shape.first(shape.size() - 1);
  }
  if (expected_components > 1 && extent.components != expected_components) {
    std::string hint;
    const size_t rank = shape.size();
    if (rank >= 2 && shape[rank - 1] <= 4 && shape[rank - 2] <= 4 &&
        shape[rank - 1] * shape[rank - 2] == expected_components) {
      hint = cat("; a matrix is ", expected_components, " numbers, column after column");
    } else if (rank == 0) {
      hint = expected_components == 2   ? "; such as =[0, 0]"
             : expected_components == 3 ? "; such as =[0, 0, 0]"
                                        : "; a list of them does";
    }
    fail("shape ", shape_text(shape), " does not end in the ", expected_components, " components of an element", hint);
  }
  if (sides.size() > 3) {
    fail("shape ", shape_text(shape), " has too many dimensions, expected layers, height, width",
         expected_components > 1 ? " and components" : "");
  }
  int64_t* const targets[] = {&extent.width, &extent.height, &extent.layers};
  for (size_t i = 0; i < std::min(sides.size(), std::size(targets)); ++i) *targets[i] = sides[sides.size() - 1 - i];
  return extent;
}

Array parse_npy(std::span<const uint8_t> file, int expected_components) {
  constexpr std::string_view kMagic = "\x93NUMPY";
  constexpr size_t kMaxHeader = size_t{1} << 20;
  if (!as_text(file).starts_with(kMagic)) fail("byte 0: not a .npy file");
  const auto need = [&](size_t count) {
    if (file.size() < count) fail("byte ", file.size(), ": the header is cut short");
  };
  need(10);
  const int version = file[6];
  if (version < 1 || version > 3) fail("byte 6: version ", version, ", only 1 to 3 are read");
  const size_t text_start = version == 1 ? 10 : 12;
  need(text_start);
  const auto length = static_cast<size_t>(load(file.subspan(8), 0, version == 1 ? 2 : 4, false));
  if (length > kMaxHeader) fail("byte 8: a header of ", length, " bytes, the limit is ", kMaxHeader);
  need(text_start + length);
  const Header header = HeaderReader(as_text(file.subspan(text_start, length)), text_start).read();

  ElementKind kind = kind_of_descr(header.descr);
  if (header.fortran_order && header.shape.size() > 1) {
    fail("it is stored in Fortran order, save it through numpy.ascontiguousarray");
  }
  const Extent extent = extent_of_shape(header.shape, expected_components);
  Array array;
  // Compare sizes before anything is allocated. The product cannot wrap: every side was checked on the way.
  checked_byte_count(ElementKind::Float64, extent.components, extent.width, extent.height, extent.layers);
  const auto count = static_cast<uint64_t>(extent.components) * static_cast<uint64_t>(extent.width) *
                     static_cast<uint64_t>(extent.height) * static_cast<uint64_t>(extent.layers);
  const auto size = static_cast<size_t>(header.descr[2] - '0');
  const std::span<const uint8_t> data = file.subspan(text_start + length);
  if (data.size() != count * size) {
    fail("shape ", shape_text(header.shape), " of ", in_quotes(header.descr), " takes ", count * size,
         " bytes, the file has ", data.size());
  }
  // NumPy's own integers may hold those that only a uint32 can.
  if (kind == ElementKind::Int32 && size == 8 && fits_unsigned(data, header.descr[0] == '>'))
    kind = ElementKind::UInt32;
  array = checked_zeros(kind, extent.components, extent.width, extent.height, extent.layers);

  const bool big_endian = header.descr[0] == '>';
  for (size_t i = 0; i < count; ++i) {
    const uint64_t bits = load(data, i, size, big_endian);
    switch (kind) {
      case ElementKind::Float32:
        put(array, i,
            size == 2 ? half_to_float(static_cast<uint16_t>(bits)) : std::bit_cast<float>(static_cast<uint32_t>(bits)));
        break;
      case ElementKind::Float64: put(array, i, std::bit_cast<double>(bits)); break;
      case ElementKind::Int32: {
        // Sign extension by shifting through the top.
        const auto shift = static_cast<int>(64 - 8 * size);
        const int64_t value = static_cast<int64_t>(bits << shift) >> shift;
        if (value < std::numeric_limits<int32_t>::min() || value > std::numeric_limits<int32_t>::max()) {
          fail("scalar ", i, " is ", value, ", which does not fit an int32");
        }
        put(array, i, static_cast<int32_t>(value));
        break;
      }
      case ElementKind::UInt32:
        if (bits > std::numeric_limits<uint32_t>::max()) {
          fail("scalar ", i, " is ", bits, ", which does not fit a uint32");
        }
        put(array, i, static_cast<uint32_t>(bits));
        break;
      case ElementKind::Bool:
        if (bits > 1) fail("scalar ", i, " of a bool array is ", bits);
        put(array, i, static_cast<uint8_t>(bits));
        break;
    }
  }
  return array;
}

Bytes encode_npy(const Array& array) {
  std::vector<int64_t> shape = {array.layers, array.height, array.width};
  // Leading ones say nothing: a reader fills them in. One dimension stays, and the components are always there.
  while (shape.size() > 1 && shape.front() == 1) shape.erase(shape.begin());
  if (array.components > 1) shape.push_back(array.components);

  std::string_view descr;
  switch (array.kind) {
    case ElementKind::Float32: descr = "<f4"; break;
    case ElementKind::Float64: descr = "<f8"; break;
    case ElementKind::Int32: descr = "<i4"; break;
    case ElementKind::UInt32: descr = "<u4"; break;
    case ElementKind::Bool: descr = "|b1"; break;
  }
  std::string header = cat("{'descr': '", descr, "', 'fortran_order': False, 'shape': ", shape_text(shape), ", }");
  // The data starts at a multiple of 64, as NumPy asks for; the padding ends in a newline.
  constexpr size_t kPrefix = 10;
  header.append((64 - (kPrefix + header.size() + 1) % 64) % 64, ' ');
  header += '\n';

  Bytes out(kPrefix + header.size() + array.bytes.size());
  std::memcpy(out.data(), "\x93NUMPY\x01\x00", 8);
  out[8] = static_cast<uint8_t>(header.size() & 255);
  out[9] = static_cast<uint8_t>(header.size() >> 8);
  std::memcpy(out.data() + kPrefix, header.data(), header.size());
  uint8_t* data = out.data() + kPrefix + header.size();
  [[maybe_unused]] const size_t size = scalar_size(array.kind);
  std::memcpy(data, array.bytes.data(), array.bytes.size());
  if constexpr (std::endian::native == std::endian::big) {
    for (size_t i = 0; i < array.bytes.size(); i += size) std::reverse(data + i, data + i + size);
  }
  return out;
}

}  // namespace dr::io
