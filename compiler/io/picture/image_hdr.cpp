// SPDX-License-Identifier: Apache-2.0
// A strict reader of Radiance HDR pictures (RGBE, either run-length coding or none). Colours are as stored; exposure
// and primaries of the header are not applied.

#include <array>
#include <charconv>
#include <cmath>

#include "compiler/io/file/failure.h"
#include "compiler/io/picture/image.h"

namespace dr::io {
namespace {

using Rgbe = std::array<uint8_t, 4>;

class HdrReader {
 public:
  explicit HdrReader(std::span<const uint8_t> file) : file_(file) {}

  Picture read() {
    header();
    Picture picture;
    picture.width = width_;
    picture.height = height_;
    picture.channels = 3;
    picture.linear = true;
    // Every row takes 4 bytes at least, which bounds what a short file can claim.
    const size_t left = file_.size() - at_;
    if (left / 4 < static_cast<size_t>(height_)) {
      fail("byte ", at_, ": the file is cut short, ", left, " bytes cannot hold ", height_, " rows");
    }
    std::vector<Rgbe> row(static_cast<size_t>(width_));
    // Runs stand for many pixels: all of them are counted before the picture takes memory.
    const size_t start = at_;
    for (y_ = 0; y_ < height_; ++y_) scanline(row, false);
    at_ = start;
    picture.floats.resize(static_cast<size_t>(width_ * height_) * 3);
    float* out = picture.floats.data();
    for (y_ = 0; y_ < height_; ++y_) {
      scanline(row, true);
      for (const Rgbe& pixel : row) {
        // A zero exponent is black. The mantissas stand for whole steps, as every common reader takes them.
        const float scale = pixel[3] == 0 ? 0.0f : std::ldexp(1.0f, int{pixel[3]} - (128 + 8));
        for (size_t k = 0; k < 3; ++k) *out++ = static_cast<float>(pixel[k]) * scale;
      }
    }
    return picture;
  }

 private:
  std::string_view line() {
    constexpr size_t kLongest = 4096;
    const std::string_view rest = as_text(file_).substr(at_, kLongest);
    const size_t length = rest.find('\n');
    if (length == std::string_view::npos) fail("byte ", at_, ": the header is cut short");
    at_ += length + 1;
    std::string_view text = rest.substr(0, length);
    if (text.ends_with('\r')) text.remove_suffix(1);
    return text;
  }

  void header() {
    const std::string_view magic = as_text(file_).substr(0, 2);
    if (magic != "#?") fail("byte 0: not a Radiance HDR file");
    line();
    bool has_format = false;
    while (true) {
      const size_t start = at_;
      const std::string_view text = line();
      if (text.empty()) break;
      if (text.starts_with("FORMAT=")) {
        if (text != "FORMAT=32-bit_rle_rgbe")
          fail("byte ", start, ": ", in_quotes(text), ", only 32-bit_rle_rgbe is read");
        has_format = true;
      }
    }
    if (!has_format) fail("byte ", at_, ": the header has no FORMAT");
    resolution();
  }

  // "-Y 512 +X 1024": rows from the top, columns from the left.
  void resolution() {
    const size_t start = at_;
    std::string_view text = line();
    const std::string shown = in_quotes(text);
    const auto side = [&](std::string_view prefix) {
      int64_t value = 0;
      const bool has_prefix = text.starts_with(prefix);
      if (has_prefix) text.remove_prefix(prefix.size());
      const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
      if (!has_prefix || error != std::errc()) fail("byte ", start, ": ", shown, ", expected '-Y height +X width'");
      text.remove_prefix(static_cast<size_t>(end - text.data()));
      return value;
    };
    height_ = side("-Y ");
    width_ = side(" +X ");
    if (!text.empty()) fail("byte ", start, ": ", shown, ", expected '-Y height +X width'");
    if (width_ < 1 || height_ < 1 || width_ > kMaxImageSide || height_ > kMaxImageSide) {
      fail("byte ", start, ": a picture of ", width_, "x", height_, ", sides must be in 1 to ", kMaxImageSide);
    }
    check_decoded_size({width_, height_, 3, sizeof(float)}, start);
  }

  void need(size_t count) const {
    if (count > file_.size() - at_) fail("byte ", file_.size(), ": the file is cut short in row ", y_);
  }

  Rgbe pixel() {
    need(4);
    const Rgbe value = {file_[at_], file_[at_ + 1], file_[at_ + 2], file_[at_ + 3]};
    at_ += 4;
    return value;
  }

  // Reads one row; without `keep` its runs are only counted.
  void scanline(std::vector<Rgbe>& row, bool keep) {
    need(4);
    const bool coded =
        row.size() >= 8 && row.size() < 32768 && file_[at_] == 2 && file_[at_ + 1] == 2 && (file_[at_ + 2] & 0x80) == 0;
    if (!coded) return flat_scanline(row, keep);
    const size_t length = static_cast<size_t>(file_[at_ + 2]) << 8 | file_[at_ + 3];
    if (length != row.size()) {
      fail("byte ", at_, ": row ", y_, " says it has ", length, " pixels, the picture has ", row.size());
    }
    at_ += 4;
    for (size_t channel = 0; channel < 4; ++channel) {
      for (size_t x = 0; x < row.size();) {
        need(1);
        const size_t start = at_;
        const size_t code = file_[at_++];
        const bool run = code > 128;
        const size_t count = run ? code - 128 : code;
        if (count == 0 || count > row.size() - x) fail("byte ", start, ": a run of ", count, " leaves row ", y_);
        need(run ? 1 : count);
        for (size_t i = 0; keep && i < count; ++i) row[x + i][channel] = file_[run ? at_ : at_ + i];
        at_ += run ? 1 : count;
        x += count;
      }
    }
  }

  // Pixels one after another; (1, 1, 1, n) repeats the last one, and several in a row add further bytes to the count.
  void flat_scanline(std::vector<Rgbe>& row, bool keep) {
    int shift = 0;
    for (size_t x = 0; x < row.size();) {
      const size_t start = at_;
      const Rgbe value = pixel();
      if (value[0] != 1 || value[1] != 1 || value[2] != 1) {
        row[x++] = value;
        shift = 0;
        continue;
      }
      const size_t count = shift < 32 ? static_cast<size_t>(value[3]) << shift : 0;
      if (x == 0 || count == 0 || count > row.size() - x)
        fail("byte ", start, ": a run of ", count, " leaves row ", y_);
      for (size_t i = 0; keep && i < count; ++i) row[x + i] = row[x - 1];
      x += count;
      shift += 8;
    }
  }

  std::span<const uint8_t> file_;
  size_t at_ = 0;
  int64_t width_ = 0;
  int64_t height_ = 0;
  int64_t y_ = 0;
};

}  // namespace

Picture decode_hdr(std::span<const uint8_t> file) { return HdrReader(file).read(); }

}  // namespace dr::io
