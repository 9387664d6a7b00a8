// SPDX-License-Identifier: Apache-2.0
// Pictures to linear float arrays: channel selection, the sRGB curve, stacks of layers.

#include "compiler/io/picture/image.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>

#include "compiler/io/array/checked.h"
#include "compiler/io/file/failure.h"

namespace dr::io {
namespace {

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

void check_size(const PictureSize& size, size_t at) {
  if (size.width < 1 || size.height < 1 || size.width > kMaxImageSide || size.height > kMaxImageSide) {
    fail("byte ", at, ": a picture of ", size.width, "x", size.height, ", sides must be in 1 to ", kMaxImageSide);
  }
}

void check_decoded_size(const PictureSize& size, size_t at) {
  const int64_t bytes = size.width * size.height * size.channels * size.sample_bytes;  // sides are checked: no overflow
  if (bytes <= kMaxDecodedBytes) return;
  fail("byte ", at, ": a picture of ", size.width, "x", size.height, " with ", size.channels, " x ",
       size.sample_bytes * 8, " bits takes ", bytes, " bytes, the limit is ", kMaxDecodedBytes);
}

bool is_image_extension(std::string_view extension) {
  return extension == ".png" || extension == ".jpg" || extension == ".jpeg" || extension == ".hdr";
}

Picture decode_png_or_jpeg(std::span<const uint8_t> file) {
  if (file.empty()) fail("the file is empty");
  if (file.size() >= 3 && std::memcmp(file.data(), "GIF", 3) == 0) fail("byte 0: this is a GIF file");
  // By content: a .png that holds a JPEG is common, and harmless.
  if (file[0] == 0x89) return decode_png(file);
  if (file[0] == 0xff) return decode_jpeg(file);
  fail("byte 0: neither a PNG nor a JPEG file");
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
  bool first_curved = false;
  for (size_t layer = 0; layer < paths.size(); ++layer) {
    const auto work = [&] {
      const Picture picture = decode(read_file(paths[layer]), extension_of(paths[layer]));
      const std::vector<ChannelSource> sources = sources_of(picture, options);
      const int components = static_cast<int>(sources.size());
      check_components(components, picture.channels, options);
      const bool curved = std::ranges::any_of(sources, &ChannelSource::curved);
      if (layer == 0) {
        first_channels = picture.channels;
        first_curved = curved;
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
      // One value would become two numbers.
      if (curved != first_curved) {
        fail("it stores ", channel_names(picture.channels), ", ", path_in_quotes(paths[0]), " stores ",
             channel_names(first_channels),
             ", and the sRGB curve is undone for the colour alone; ':raw:r' takes all "
             "as stored, ':rgb' as colours");
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

}  // namespace dr::io
