// SPDX-License-Identifier: Apache-2.0
// Pictures to linear float arrays and back: channel selection, the sRGB curve, stacks of layers, and the PNG and JPEG
// codecs (stb, compiled here alone and for these two formats only).

#include "compiler/io/picture/image.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <memory>

#include "compiler/io/array/checked.h"
#include "compiler/io/file/failure.h"

namespace {

// A compressed stream can ask for a thousand times its size. The decoder gets as much as the header's picture can need,
// and its own error path does the rest.
thread_local size_t stb_allocation_limit = 0;

// Cleared, so that what a damaged file leaves out is zero instead of whatever the memory held.
void* stb_allocate(size_t size) { return size <= stb_allocation_limit ? std::calloc(size, 1) : nullptr; }
void* stb_reallocate(void* block, size_t size) {
  return size <= stb_allocation_limit ? std::realloc(block, size) : nullptr;
}

}  // namespace

#define STB_IMAGE_STATIC
#define STB_IMAGE_IMPLEMENTATION
#define STBI_ONLY_PNG
#define STBI_ONLY_JPEG
#define STBI_NO_STDIO
#define STBI_MAX_DIMENSIONS 16384
#define STBI_MALLOC(size) stb_allocate(size)
#define STBI_REALLOC(block, size) stb_reallocate(block, size)
#define STBI_FREE(block) std::free(block)
#define STB_IMAGE_WRITE_STATIC
#define STB_IMAGE_WRITE_IMPLEMENTATION
#define STBI_WRITE_NO_STDIO
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wunused-function"
#include <stb/stb_image.h>
#include <stb/stb_image_write.h>
#pragma GCC diagnostic pop

namespace dr::io {
namespace {

struct FreeStb {
  void operator()(void* block) const { std::free(block); }
};

// A table of the curve for every stored value.
std::vector<float> curve_table(size_t levels, bool linear) {
  std::vector<float> table(levels);
  const double top = static_cast<double>(levels - 1);
  for (size_t i = 0; i < levels; ++i) {
    const double value = static_cast<double>(i) / top;
    table[i] = static_cast<float>(linear ? value : srgb_to_linear(value));
  }
  return table;
}

const std::vector<float>& curve_of(int bits, bool linear) {
  static const std::vector<float> kLinear8 = curve_table(256, true);
  static const std::vector<float> kSrgb8 = curve_table(256, false);
  if (bits == 8) return linear ? kLinear8 : kSrgb8;
  static const std::vector<float> kLinear16 = curve_table(65536, true);
  static const std::vector<float> kSrgb16 = curve_table(65536, false);
  return linear ? kLinear16 : kSrgb16;
}

// For each output channel, the stored channel it comes from (-1: it is 1) and whether the curve applies.
struct ChannelSource {
  int channel = -1;
  bool curved = false;
};

std::string_view channel_names(int channels) {
  constexpr std::string_view kNames[] = {"", "grey", "grey and alpha", "rgb", "rgba"};
  return kNames[channels];
}

std::vector<ChannelSource> sources_of(const Picture& picture, const ImageOptions& options) {
  const int channels = picture.channels;
  const bool linear = picture.linear || options.raw;
  const bool colour = channels >= 3, curved = colour || options.of_material;
  const bool has_alpha = channels == 2 || channels == 4;
  const ChannelSource alpha = {has_alpha ? channels - 1 : -1, false};
  const auto value = [&](int channel, bool as_colour) {
    return ChannelSource{colour ? channel : 0, as_colour && !linear};
  };
  switch (options.channels) {
    case ImageChannels::AsStored: {
      std::vector<ChannelSource> all;
      for (int c = 0; c < (colour ? 3 : 1); ++c) all.push_back(value(c, curved));
      if (has_alpha) all.push_back(alpha);
      return all;
    }
    case ImageChannels::R: return {value(0, curved)};
    case ImageChannels::G: return {value(1, curved)};
    case ImageChannels::B: return {value(2, curved)};
    case ImageChannels::Rgb: return {value(0, true), value(1, true), value(2, true)};
    case ImageChannels::Rgba: return {value(0, true), value(1, true), value(2, true), alpha};
    case ImageChannels::A:
      if (!has_alpha && !options.of_material) fail("it has no alpha, it stores ", channel_names(channels));
      return {alpha};
  }
  return {};
}

void check_components(int found, int stored, const ImageOptions& options) {
  const int expected = options.expected_components;
  if (expected == 0 || expected == found) return;
  constexpr std::string_view kHints[] = {"", "':r' picks one", "", "':rgb' gives the colour",
                                         "':rgba' gives the colour and alpha"};
  const std::string hint = expected == 1 || expected == 3 || expected == 4 ? cat("; ", kHints[expected]) : "";
  fail("it gives ", counted(found, "component", "components"), " (it stores ", channel_names(stored), "), expected ",
       expected, hint);
}

Picture decode(std::span<const uint8_t> file, const std::string& extension) {
  return extension == ".hdr" ? decode_hdr(file) : decode_png_or_jpeg(file);
}

// Writes the chosen channels of `picture` as floats.
void convert(const Picture& picture, const std::vector<ChannelSource>& sources, float* out) {
  const auto pixels = static_cast<size_t>(picture.width * picture.height);
  const auto channels = static_cast<size_t>(picture.channels);
  const size_t count = sources.size();
  for (size_t k = 0; k < count; ++k) {
    const ChannelSource source = sources[k];
    if (source.channel < 0) {
      for (size_t i = 0; i < pixels; ++i) out[i * count + k] = 1.0f;
      continue;
    }
    const auto channel = static_cast<size_t>(source.channel);
    if (picture.linear) {
      for (size_t i = 0; i < pixels; ++i) out[i * count + k] = picture.floats[i * channels + channel];
      continue;
    }
    const std::vector<float>& curve = curve_of(picture.bits, !source.curved);
    if (picture.bits == 8) {
      for (size_t i = 0; i < pixels; ++i) out[i * count + k] = curve[picture.samples8[i * channels + channel]];
    } else {
      for (size_t i = 0; i < pixels; ++i) out[i * count + k] = curve[picture.samples16[i * channels + channel]];
    }
  }
}

}  // namespace

double srgb_to_linear(double value) {
  return value <= 0.04045 ? value / 12.92 : std::pow((value + 0.055) / 1.055, 2.4);
}

double linear_to_srgb(double value) {
  return value <= 0.0031308 ? value * 12.92 : 1.055 * std::pow(value, 1 / 2.4) - 0.055;
}

bool is_image_extension(std::string_view extension) {
  return extension == ".png" || extension == ".jpg" || extension == ".jpeg" || extension == ".hdr";
}

Picture decode_png_or_jpeg(std::span<const uint8_t> file) {
  if (file.empty()) fail("the file is empty");
  if (file.size() >= 3 && std::memcmp(file.data(), "GIF", 3) == 0) fail("byte 0: this is a GIF file");
  // By content: a .png that holds a JPEG is common, and harmless.
  const bool png = file[0] == 0x89;
  if (!png && file[0] != 0xff) fail("byte 0: neither a PNG nor a JPEG file");
  const PictureSize size = png ? check_png(file) : check_jpeg(file);

  // The largest single block: 4 channels of 16 bits, a filter byte a row, doubled because the inflating buffer grows by
  // doubling; and some room for the fixed tables.
  const auto pixels = static_cast<size_t>(size.width * size.height);
  stb_allocation_limit = (pixels * 8 + static_cast<size_t>(size.height)) * 2 + (size_t{1} << 20);

  const auto* data = file.data();
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
  if (png && stbi_is_16_bit_from_memory(data, length) != 0) {
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
  return picture;
}

Array to_array(const Picture& picture, const ImageOptions& options) {
  const std::vector<ChannelSource> sources = sources_of(picture, options);
  check_components(static_cast<int>(sources.size()), picture.channels, options);
  Array array =
      checked_zeros(ElementKind::Float32, static_cast<int64_t>(sources.size()), picture.width, picture.height, 1);
  convert(picture, sources, array.as<float>().data());
  return array;
}

ImageOptions image_options(std::span<const std::string_view> selectors, ImageOptions options) {
  constexpr std::pair<std::string_view, ImageChannels> kChannels[] = {
      {"r", ImageChannels::R}, {"rgb", ImageChannels::Rgb}, {"rgba", ImageChannels::Rgba}, {"a", ImageChannels::A}};
  constexpr std::string_view kNames[] = {"raw", "r", "rgb", "rgba", "a"};
  bool chosen = false;
  for (const std::string_view selector : selectors) {
    if (selector == "raw") {
      options.raw = true;
      continue;
    }
    const auto* found = std::find_if(std::begin(kChannels), std::end(kChannels),
                                     [&](const auto& entry) { return entry.first == selector; });
    if (found == std::end(kChannels)) {
      fail("unknown selector ", in_quotes(selector), did_you_mean(selector, kNames),
           ", a picture takes ':raw', ':r', ':rgb', ':rgba' or ':a'");
    }
    if (chosen) fail("one of ':r', ':rgb', ':rgba' and ':a' is enough");
    chosen = true;
    options.channels = found->second;
  }
  return options;
}

Array read_images(const std::vector<std::string>& paths, const ImageOptions& options) {
  Array array;
  int first_channels = 0;
  for (size_t layer = 0; layer < paths.size(); ++layer) {
    const auto work = [&] {
      const Picture picture = decode(read_file(paths[layer]), extension_of(paths[layer]));
      const std::vector<ChannelSource> sources = sources_of(picture, options);
      const int components = static_cast<int>(sources.size());
      check_components(components, picture.channels, options);
      if (layer == 0) {
        first_channels = picture.channels;
        array = checked_zeros(ElementKind::Float32, components, picture.width, picture.height,
                              static_cast<int64_t>(paths.size()));
      }
      if (picture.width != array.width || picture.height != array.height) {
        fail("it has ", picture.width, "x", picture.height, " pixels, ", path_in_quotes(paths[0]), " has ", array.width,
             "x", array.height, "; the pictures of a stack have one size");
      }
      if (components != array.components) {
        fail("it stores ", channel_names(picture.channels), ", ", path_in_quotes(paths[0]), " stores ",
             channel_names(first_channels), "; ':r', ':rgb' or ':rgba' make them alike");
      }
      const auto floats = array.as<float>();
      convert(picture, sources, floats.data() + floats.size() / paths.size() * layer);
    };
    if (paths.size() == 1) {
      work();
      continue;
    }
    try {
      work();
    } catch (const Failure& failure) {
      fail(path_in_quotes(paths[layer]), ": ", failure.what());
    }
  }
  return array;
}

Bytes encode_png(const Array& array, int64_t layer, bool raw) {
  const bool is_float = array.kind == ElementKind::Float32 || array.kind == ElementKind::Float64;
  if (!is_float && array.kind != ElementKind::Bool) {
    fail("a PNG holds floats in 0 to 1 or bools, found ", kind_name(array.kind), "; .npy holds any kind");
  }
  if (array.components > 4) fail("a PNG holds 1 to 4 components, found ", array.components);
  if (array.width > kMaxImageSide || array.height > kMaxImageSide) {
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
