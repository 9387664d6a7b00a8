// SPDX-License-Identifier: Apache-2.0
// Pictures: PNG, JPEG and Radiance HDR in, PNG out. Private to compiler/io; every function throws Failure.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "compiler/io/array/array.h"
#include "compiler/io/file/file.h"

namespace dr::io {

// The largest width and height, checked in the header before anything is decoded.
inline constexpr int64_t kMaxImageSide = 16384;
// The most bytes that the samples of one picture may take once they are decoded: the decoders count in 32 bits, and a
// few bytes of a file can stand for any number of samples. Checked before anything is decoded.
inline constexpr int64_t kMaxDecodedBytes = (int64_t{1} << 31) - 1;

enum class ImageChannels : uint8_t { AsStored, R, G, B, Rgb, Rgba, A };

struct ImageOptions {
  ImageChannels channels = ImageChannels::AsStored;
  bool raw = false;             // leave out the sRGB curve
  bool of_material = false;     // grey is a colour, too, and what has no alpha is opaque
  int expected_components = 0;  // 0: any
};

// A picture as stored: one scalar in [0, 1] (HDR: any) for each of 1 to 4 channels, rows from the top.
struct Picture {
  int64_t width = 0;
  int64_t height = 0;
  int channels = 0;     // 1 grey, 2 grey and alpha, 3 colour, 4 colour and alpha
  bool linear = false;  // HDR: there is no curve to undo
  int bits = 8;         // 8 or 16 for integer samples
  std::vector<uint8_t> samples8;
  std::vector<uint16_t> samples16;
  std::vector<float> floats;
};

// What the header of a file says. Of a PNG the structure of the whole file was walked: one that is cut short or whose
// chunks do not add up fails here, before a decoder sees it.
struct PictureSize {
  int64_t width = 0;
  int64_t height = 0;
  int64_t channels = 0;  // at most, of the decoded samples
  int64_t sample_bytes = 1;
};
// Fail when a side is not in 1 to kMaxImageSide, and when the decoded samples would pass kMaxDecodedBytes. `at` is the
// byte of the file that gives the size.
void check_size(const PictureSize& size, size_t at);
void check_decoded_size(const PictureSize& size, size_t at);
PictureSize check_png(std::span<const uint8_t> file);
PictureSize check_jpeg(std::span<const uint8_t> file);

Picture decode_png(std::span<const uint8_t> file);
Picture decode_jpeg(std::span<const uint8_t> file);
Picture decode_png_or_jpeg(std::span<const uint8_t> file);
Picture decode_hdr(std::span<const uint8_t> file);

// One decoded picture as an array.
Array to_array(const Picture& picture, const ImageOptions& options);

// What `:raw`, `:r`, `:rgb`, `:rgba` and `:a` choose, on top of `options`.
ImageOptions image_options(std::span<const std::string_view> selectors, ImageOptions options);

// Reads the files as the layers of one array; they must agree in size, channels and whether the curve is undone.
// Precondition: at least one path.
Array read_images(const std::vector<std::string>& paths, const ImageOptions& options);

// One layer as an 8-bit PNG; the rules are save_array's, but for `raw`, which leaves the curve out.
Bytes encode_png(const Array& array, int64_t layer, bool raw = false);

// The sRGB curve, both ways.
double srgb_to_linear(double value);
double linear_to_srgb(double value);

bool is_image_extension(std::string_view extension);

}  // namespace dr::io
