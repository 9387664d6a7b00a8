// SPDX-License-Identifier: Apache-2.0
// PNG files, by stb, which is compiled here alone and for this format only. The structure of a file is walked before it
// is decoded, so that the decoder sees only what adds up: it would fill what is missing from a file that was cut short.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <memory>
#include <optional>
#include <utility>

#include "compiler/io/file/failure.h"
#include "compiler/io/picture/image.h"

namespace {

// A compressed stream can ask for a thousand times its size. The decoder gets as much as the header's picture can need,
// and its own error path does the rest.
thread_local size_t stb_allocation_limit = 0;

// Cleared, so that what a damaged file leaves out is zero instead of whatever the memory held.
void* stb_allocate(size_t size) {
  return size <= stb_allocation_limit ? std::calloc(std::max<size_t>(size, 1), 1) : nullptr;
}
void* stb_reallocate(void* block, size_t size) {
  return size <= stb_allocation_limit ? std::realloc(block, size) : nullptr;
}

}  // namespace

#define STB_IMAGE_STATIC
#define STB_IMAGE_IMPLEMENTATION
#define STBI_ONLY_PNG
#define STBI_NO_STDIO
#define STBI_MAX_DIMENSIONS 16384
#define STBI_MALLOC(size) stb_allocate(size)
#define STBI_REALLOC(block, size) stb_reallocate(block, size)
#define STBI_FREE(block) std::free(block)
#define STB_IMAGE_WRITE_STATIC
#define STB_IMAGE_WRITE_IMPLEMENTATION
#define STBI_WRITE_NO_STDIO
#define STBIW_MALLOC(size) stb_allocate(size)
#define STBIW_REALLOC(block, size) stb_reallocate(block, size)
#define STBIW_FREE(block) std::free(block)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wunused-function"
#include <stb/stb_image.h>
#include <stb/stb_image_write.h>
#pragma GCC diagnostic pop

namespace dr::io {
namespace {

// Bytes of the header, and what they say.
constexpr size_t kBitsAt = 24, kColourTypeAt = 25;
constexpr uint8_t kGrey = 0, kPaletted = 3;

struct FreeStb {
  void operator()(void* block) const { std::free(block); }
};

uint32_t big_u32(std::span<const uint8_t> file, size_t at) {
  return static_cast<uint32_t>(file[at]) << 24 | static_cast<uint32_t>(file[at + 1]) << 16 |
         static_cast<uint32_t>(file[at + 2]) << 8 | static_cast<uint32_t>(file[at + 3]);
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

// What a PNG's header says of its samples, as the decoder gives them: a palette becomes a colour, fewer than 8 bits 8.
PictureSize png_header(std::span<const uint8_t> file) {
  const uint8_t bits = file[kBitsAt];
  const uint8_t colour_type = file[kColourTypeAt];
  PictureSize size = {big_u32(file, 16), big_u32(file, 20)};
  size.channels = colour_type == 0 ? 1 : colour_type == 4 ? 2 : colour_type == 2 ? 3 : 4;
  size.sample_bytes = bits == 16 ? 2 : 1;
  return size;
}

}  // namespace

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

// The colours that a picture's indices name.
struct Palette {
  std::span<const uint8_t> colours;  // three bytes each
  std::span<const uint8_t> alphas;   // of the first ones
  int64_t size() const { return static_cast<int64_t>(colours.size() / 3); }
};

// The decoder does not compare indices with the palette, and reads what it never wrote behind its end. So it gets the
// indices as a picture of grey, and the colours are looked up here. `file` is one that check_png() takes; it becomes
// that picture.
Palette take_palette(std::span<const uint8_t> file, std::vector<uint8_t>& grey) {
  Palette palette;
  if (file[kBitsAt] > 8) fail("byte ", kBitsAt, ": a picture with a palette has at most 8 bits, found ", file[kBitsAt]);
  grey.assign(file.begin(), file.end());
  grey[kColourTypeAt] = kGrey;
  for (size_t at = 8; true;) {
    const size_t length = big_u32(file, at);
    const std::string_view name = as_text(file.subspan(at + 4, 4));
    const auto data = file.subspan(at + 8, length);
    if (name == "PLTE") {
      if (length == 0 || length % 3 != 0 || length > 256 * 3)
        fail("byte ", at, ": a palette of ", length, " bytes, expected 1 to 256 colours of 3");
      palette.colours = data;
    }
    if (name == "tRNS") {
      if (static_cast<int64_t>(length) > palette.size())
        fail("byte ", at, ": ", length, " alphas for a palette of ", palette.size());
      palette.alphas = data;
      grey[at + 7] = 's';  // what a grey picture says by it is something else; chunks of unknown names are passed over
    }
    if (name == "IDAT" || name == "IEND") break;
    at += 12 + length;
  }
  if (palette.colours.empty()) fail("there is no palette before the picture data");
  return palette;
}

// Indices, as the decoder scales grey values of so few bits, become colours.
void apply(const Palette& palette, int bits, Picture& picture) {
  const int scale = 255 / ((1 << bits) - 1);
  const std::vector<uint8_t> indices = std::exchange(picture.samples8, {});
  picture.channels = palette.alphas.empty() ? 3 : 4;
  picture.samples8.reserve(indices.size() * static_cast<size_t>(picture.channels));
  for (size_t i = 0; i < indices.size(); ++i) {
    const int index = indices[i] / scale;
    if (index >= palette.size()) {
      const auto width = static_cast<size_t>(picture.width);
      fail("the pixel at x ", i % width, ", y ", i / width, " has the colour ", index, " of a palette of ",
           palette.size());
    }
    const auto k = static_cast<size_t>(index);
    picture.samples8.insert(picture.samples8.end(), palette.colours.begin() + 3 * index,
                            palette.colours.begin() + 3 * index + 3);
    if (picture.channels == 4) picture.samples8.push_back(k < palette.alphas.size() ? palette.alphas[k] : 255);
  }
}

}  // namespace

Picture decode_png(std::span<const uint8_t> file) {
  const PictureSize size = check_png(file);
  const int bits = file[kBitsAt];
  std::vector<uint8_t> grey;
  std::optional<Palette> palette;
  if (file[kColourTypeAt] == kPaletted) palette = take_palette(file, grey);

  // The largest single block: 4 channels of 16 bits, a filter byte a row, doubled because the inflating buffer grows by
  // doubling; and some room for the fixed tables.
  const auto pixels = static_cast<size_t>(size.width * size.height);
  stb_allocation_limit = (pixels * 8 + static_cast<size_t>(size.height)) * 2 + (size_t{1} << 20);

  const auto* data = palette ? grey.data() : file.data();
  const int length = static_cast<int>(file.size());
  Picture picture;
  int width = 0;
  int height = 0;
  stbi__g_failure_reason = nullptr;  // not every refusal sets one, and an old one would mislead
  const auto check = [&](const void* decoded) {
    const char* reason = stbi_failure_reason();
    if (!decoded) fail("the picture data is damaged (", reason ? reason : "the decoder gives no reason", ")");
    if (width != size.width || height != size.height) fail("the picture data is damaged");
  };
  if (stbi_is_16_bit_from_memory(data, length) != 0) {
    const std::unique_ptr<stbi_us, FreeStb> samples(
        stbi_load_16_from_memory(data, length, &width, &height, &picture.channels, 0));
    check(samples.get());
    picture.bits = 16;
    picture.samples16.assign(samples.get(), samples.get() + pixels * static_cast<size_t>(picture.channels));
  } else {
    const std::unique_ptr<stbi_uc, FreeStb> samples(
        stbi_load_from_memory(data, length, &width, &height, &picture.channels, 0));
    check(samples.get());
    picture.samples8.assign(samples.get(), samples.get() + pixels * static_cast<size_t>(picture.channels));
  }
  picture.width = width;
  picture.height = height;
  if (palette) apply(*palette, bits, picture);
  return picture;
}

Bytes encode_png(const Array& array, int64_t layer, bool raw) {
  const bool is_float = array.kind == ElementKind::Float32 || array.kind == ElementKind::Float64;
  if (!is_float && array.kind != ElementKind::Bool) {
    fail("a PNG holds floats in 0 to 1 or bools, found ", kind_name(array.kind), "; .npy holds any kind");
  }
  if (array.components < 1 || array.components > 4) fail("a PNG holds 1 to 4 components, found ", array.components);
  if (array.width < 1 || array.height < 1 || array.width > kMaxImageSide || array.height > kMaxImageSide) {
    fail("a picture of ", array.width, "x", array.height, ", sides must be in 1 to ", kMaxImageSide);
  }
  const auto components = static_cast<size_t>(array.components);
  const auto count = static_cast<size_t>(array.width * array.height) * components;
  // The encoder counts bytes in an int and doubles its buffer.
  if (count > (size_t{1} << 29)) fail("a picture of ", count, " bytes is too large for a PNG");

  const size_t begin = static_cast<size_t>(layer) * count;
  const auto value_at = [&](size_t i) -> double {
    switch (array.kind) {
      case ElementKind::Float32: return array.as<float>()[begin + i];
      case ElementKind::Float64: return array.as<double>()[begin + i];
      case ElementKind::Bool: return static_cast<double>(array.bytes[begin + i] != std::byte{0});
      case ElementKind::Int32:
      case ElementKind::UInt32: break;
    }
    return 0;
  };
  std::vector<uint8_t> samples(count);
  for (size_t i = 0; i < count; ++i) {
    const double value = value_at(i);
    if (std::isnan(value)) {
      const size_t element = i / components;
      const auto width = static_cast<size_t>(array.width);
      fail("component ", i % components, " of the element at x ", element % width, ", y ", element / width, ", layer ",
           layer, " is NaN; .npy holds it");
    }
    const bool curved = !raw && components >= 3 && i % components < 3;
    const double clamped = std::clamp(value, 0.0, 1.0);
    samples[i] = static_cast<uint8_t>(std::floor((curved ? linear_to_srgb(clamped) : clamped) * 255 + 0.5));
  }
  int length = 0;
  stb_allocation_limit = std::numeric_limits<size_t>::max();
  const std::unique_ptr<unsigned char, FreeStb> png(
      stbi_write_png_to_mem(samples.data(), static_cast<int>(array.width) * array.components,
                            static_cast<int>(array.width), static_cast<int>(array.height), array.components, &length));
  if (!png) throw std::bad_alloc();
  return Bytes(png.get(), png.get() + length);
}

}  // namespace dr::io
