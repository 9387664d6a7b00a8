// SPDX-License-Identifier: Apache-2.0
// Walks the structure of PNG and JPEG files without decoding them, so that the decoder sees only what adds up. It would
// fill what is missing from a file that was cut short with grey; here that is an error that names the byte.

#include <array>
#include <cstring>

#include "compiler/io/file/failure.h"
#include "compiler/io/picture/image.h"

namespace dr::io {
namespace {

uint32_t big_u32(std::span<const uint8_t> file, size_t at) {
  return static_cast<uint32_t>(file[at]) << 24 | static_cast<uint32_t>(file[at + 1]) << 16 |
         static_cast<uint32_t>(file[at + 2]) << 8 | static_cast<uint32_t>(file[at + 3]);
}

uint32_t big_u16(std::span<const uint8_t> file, size_t at) {
  return static_cast<uint32_t>(file[at]) << 8 | static_cast<uint32_t>(file[at + 1]);
}

uint32_t crc32(std::span<const uint8_t> bytes) {
  static const std::array<uint32_t, 256> kTable = [] {
    std::array<uint32_t, 256> table{};
    for (uint32_t i = 0; i < 256; ++i) {
      uint32_t value = i;
      for (int bit = 0; bit < 8; ++bit) value = (value & 1) != 0 ? 0xedb88320u ^ (value >> 1) : value >> 1;
      table[i] = value;
    }
    return table;
  }();
  uint32_t crc = 0xffffffffu;
  for (const uint8_t byte : bytes) crc = kTable[(crc ^ byte) & 255] ^ (crc >> 8);
  return ~crc;
}

void check_size(const PictureSize& size, size_t at) {
  if (size.width < 1 || size.height < 1 || size.width > kMaxImageSide || size.height > kMaxImageSide) {
    fail("byte ", at, ": a picture of ", size.width, "x", size.height, ", sides must be in 1 to ", kMaxImageSide);
  }
}

// What a PNG's header says of its samples, as the decoder gives them: a palette becomes a colour, fewer than 8 bits 8.
PictureSize png_header(std::span<const uint8_t> file) {
  const uint8_t bits = file[24];
  const uint8_t colour_type = file[25];
  PictureSize size = {big_u32(file, 16), big_u32(file, 20)};
  size.channels = colour_type == 0 ? 1 : colour_type == 4 ? 2 : colour_type == 2 ? 3 : 4;
  size.sample_bytes = bits == 16 ? 2 : 1;
  return size;
}

}  // namespace

void check_decoded_size(const PictureSize& size, size_t at) {
  const int64_t bytes = size.width * size.height * size.channels * size.sample_bytes;  // sides are checked: no overflow
  if (bytes <= kMaxDecodedBytes) return;
  fail("byte ", at, ": a picture of ", size.width, "x", size.height, " with ", size.channels, " x ",
       size.sample_bytes * 8, " bits takes ", bytes, " bytes, the limit is ", kMaxDecodedBytes);
}

PictureSize check_png(std::span<const uint8_t> file) {
  constexpr uint8_t kSignature[8] = {0x89, 'P', 'N', 'G', '\r', '\n', 0x1a, '\n'};
  if (file.size() < 8 || std::memcmp(file.data(), kSignature, 8) != 0) fail("byte 0: not a PNG file");
  PictureSize size;
  bool has_data = false;
  for (size_t at = 8; true;) {
    if (file.size() - at < 12) fail("byte ", at, ": the file is cut short, a chunk was expected");
    const uint64_t length = big_u32(file, at);
    const std::string_view name = as_text(file.subspan(at + 4, 4));
    const size_t left = file.size() - at - 12;
    if (length > left) {
      fail("byte ", at, ": the file is cut short, chunk ", in_quotes(name), " has ", length, " bytes, ", left,
           " are left");
    }
    const auto data_size = static_cast<size_t>(length);
    const uint32_t stored = big_u32(file, at + 8 + data_size);
    if (crc32(file.subspan(at + 4, data_size + 4)) != stored) {
      fail("byte ", at, ": chunk ", in_quotes(name), " is damaged, its checksum differs");
    }
    if (at == 8) {
      if (name != "IHDR" || length != 13) fail("byte 8: the first chunk is not a header of 13 bytes");
      size = png_header(file);
      check_size(size, at + 8);
    }
    // A transparent colour becomes an alpha.
    if (name == "tRNS" && (size.channels == 1 || size.channels == 3)) ++size.channels;
    if (name == "IDAT") has_data = true;
    if (name == "IEND") {
      if (!has_data) fail("byte ", at, ": there is no picture data");
      check_decoded_size(size, 16);
      return size;
    }
    at += 12 + data_size;
  }
}

namespace {

// Walks the segments of a JPEG file and checks what the decoder takes on trust: that Huffman tables fit their arrays,
// and that a scan uses only tables that were defined. (stb_image 2.27 checks neither, and would write and read past
// them.)
class JpegChecker {
 public:
  explicit JpegChecker(std::span<const uint8_t> file) : file_(file) {}

  PictureSize check() {
    if (file_.size() < 3 || file_[0] != 0xff || file_[1] != 0xd8 || file_[2] != 0xff) fail("byte 0: not a JPEG file");
    at_ = 2;
    while (true) {
      need(2);
      if (file_[at_] != 0xff) fail_here("expected a marker");
      const uint8_t marker = file_[at_ + 1];
      if (marker == 0xff) {  // markers may be preceded by any number of fill bytes
        ++at_;
        continue;
      }
      if (marker == 0xd9) {
        if (!has_data_) fail_here("there is no picture data");
        return size_;
      }
      if (marker == 0x00 || marker == 0x01 || (marker >= 0xd0 && marker <= 0xd8)) fail_here("unexpected marker");
      const size_t start = at_;
      at_ += 2;
      need(2);
      const size_t length = big_u16(file_, at_);
      if (length < 2) fail_here("a segment of ", length, " bytes");
      if (length > file_.size() - at_)
        fail("byte ", start, ": the file is cut short in a segment of ", length, " bytes");
      segment(marker, file_.subspan(at_ + 2, length - 2), start);
      at_ += length;
      if (marker == 0xda) skip_coded_data();
    }
  }

 private:
  using Data = std::span<const uint8_t>;

  struct Component {
    uint8_t id;
    uint8_t quantization;
  };

  template <class... Parts>
  [[noreturn]] void fail_here(const Parts&... parts) const {
    fail("byte ", at_, ": ", parts...);
  }
  void need(size_t count) const {
    if (count > file_.size() - at_) fail("byte ", file_.size(), ": the file is cut short");
  }

  void segment(uint8_t marker, Data data, size_t start) {
    const bool is_frame = marker >= 0xc0 && marker <= 0xcf && marker != 0xc4 && marker != 0xc8 && marker != 0xcc;
    if (is_frame) frame(marker, data, start);
    if (marker == 0xc4) huffman_tables(data, start);
    if (marker == 0xdb) quantization_tables(data, start);
    if (marker == 0xda) scan(data, start);
  }

  void frame(uint8_t marker, Data data, size_t start) {
    if (marker > 0xc2) fail("byte ", start, ": lossless, arithmetic and hierarchical JPEG are not read");
    if (!components_.empty()) fail("byte ", start, ": a second frame header");
    const size_t count = data.size() >= 6 ? data[5] : 0;
    if (count == 0 || data.size() != 6 + count * 3) fail("byte ", start, ": the frame header has a wrong length");
    progressive_ = marker == 0xc2;
    size_ = {big_u16(data, 3), big_u16(data, 1), static_cast<int64_t>(count)};
    check_size(size_, start);
    check_decoded_size(size_, start);
    for (size_t i = 0; i < count; ++i) components_.push_back({data[6 + i * 3], data[8 + i * 3]});
  }

  void huffman_tables(Data data, size_t start) {
    while (!data.empty()) {
      if (data.size() < 17) fail("byte ", start, ": a Huffman table is cut short");
      const size_t id = data[0] & 15;
      const size_t kind = data[0] >> 4;
      if (kind > 1 || id > 3) fail("byte ", start, ": a Huffman table has a wrong number");
      size_t symbols = 0;
      uint32_t code = 0;
      for (size_t bits = 1; bits <= 16; ++bits) {
        symbols += data[bits];
        code += data[bits];
        if (code > 1u << bits) fail("byte ", start, ": a Huffman table has more codes than bits");
        code <<= 1;
      }
      if (symbols > 256 || symbols > data.size() - 17) {
        fail("byte ", start, ": a Huffman table of ", symbols, " symbols does not fit");
      }
      has_huffman_[kind][id] = true;
      data = data.subspan(17 + symbols);
    }
  }

  void quantization_tables(Data data, size_t start) {
    while (!data.empty()) {
      const size_t id = data[0] & 15;
      const size_t wide = data[0] >> 4;
      const size_t length = wide == 0 ? 65 : 129;
      if (wide > 1 || id > 3 || data.size() < length) fail("byte ", start, ": a quantization table is damaged");
      has_quantization_[id] = true;
      data = data.subspan(length);
    }
  }

  void scan(Data data, size_t start) {
    const size_t count = data.empty() ? 0 : data[0];
    if (count == 0 || data.size() != 4 + count * 2) fail("byte ", start, ": the scan header has a wrong length");
    const uint8_t first = data[1 + count * 2];
    const bool refines = data[3 + count * 2] >> 4 != 0;
    // A progressive scan holds either the means of the blocks or the rest, first roughly and then finer.
    const bool needs_dc = !progressive_ || (first == 0 && !refines);
    const bool needs_ac = !progressive_ || first != 0;
    for (size_t i = 0; i < count; ++i) {
      const uint8_t id = data[1 + i * 2];
      const size_t dc = data[2 + i * 2] >> 4;
      const size_t ac = data[2 + i * 2] & 15;
      const Component* component = nullptr;
      for (const Component& candidate : components_) {
        if (candidate.id == id && !component) component = &candidate;
      }
      if (!component) fail("byte ", start, ": the scan names a component that the frame has not");
      if (component->quantization > 3 || !has_quantization_[component->quantization]) {
        fail("byte ", start, ": the scan uses a quantization table that is not defined");
      }
      if (dc > 3 || ac > 3 || (needs_dc && !has_huffman_[0][dc]) || (needs_ac && !has_huffman_[1][ac])) {
        fail("byte ", start, ": the scan uses a Huffman table that is not defined");
      }
    }
  }

  // Coded data runs up to the next marker that is neither a stuffed zero nor a restart.
  void skip_coded_data() {
    has_data_ = true;
    while (true) {
      const void* next = at_ < file_.size() ? std::memchr(file_.data() + at_, 0xff, file_.size() - at_) : nullptr;
      if (next) at_ = static_cast<size_t>(static_cast<const uint8_t*>(next) - file_.data());
      if (!next || at_ + 1 >= file_.size()) fail("byte ", file_.size(), ": the file is cut short");
      const uint8_t following = file_[at_ + 1];
      const bool inside = following == 0x00 || (following >= 0xd0 && following <= 0xd7);
      if (!inside) return;
      at_ += 2;
    }
  }

  Data file_;
  size_t at_ = 0;
  PictureSize size_;
  bool progressive_ = false;
  bool has_data_ = false;
  std::vector<Component> components_;
  bool has_huffman_[2][4] = {};  // [0: means, 1: the rest][number]
  bool has_quantization_[4] = {};
};

}  // namespace

PictureSize check_jpeg(std::span<const uint8_t> file) { return JpegChecker(file).check(); }

}  // namespace dr::io
