// SPDX-License-Identifier: Apache-2.0
// JPEG files, by libjpeg. Where data is missing or wrong it warns and goes on with grey; here a picture is whole or
// refused.

#include <csetjmp>
#include <cstddef>
#include <cstdio>

#include "compiler/io/file/failure.h"
#include "compiler/io/picture/image.h"

// clang-format off
#include <jpeglib.h>  // wants what stands above
#include <jerror.h>
// clang-format on

namespace dr::io {
namespace {

// A file of a few bytes can hold any number of scans, each of which takes as long as the picture is large.
constexpr int kMaxScans = 500;

class JpegReader {
 public:
  explicit JpegReader(std::span<const uint8_t> file) : file_(file) {
    cinfo_.err = jpeg_std_error(&errors_);
    errors_.error_exit = [](j_common_ptr cinfo) { leave(cinfo); };
    errors_.emit_message = [](j_common_ptr cinfo, int level) {
      if (level < 0 && !is_harmless(cinfo->err->msg_code)) leave(cinfo);
    };
    progress_.progress_monitor = [](j_common_ptr cinfo) {
      auto* self = static_cast<JpegReader*>(cinfo->client_data);
      if (self->cinfo_.input_scan_number > kMaxScans) {
        self->message_ = "it has too many scans";
        std::longjmp(self->back_, 1);
      }
    };
    cinfo_.client_data = this;
    guarded([this] { jpeg_create_decompress(&cinfo_); });
    cinfo_.progress = &progress_;
  }
  ~JpegReader() { jpeg_destroy_decompress(&cinfo_); }
  JpegReader(const JpegReader&) = delete;
  JpegReader& operator=(const JpegReader&) = delete;

  PictureSize header() {
    guarded([this] {
      jpeg_mem_src(&cinfo_, file_.data(), file_.size());
      jpeg_read_header(&cinfo_, TRUE);
    });
    const int components = cinfo_.num_components;
    if (components != 1 && components != 3 && components != 4) {
      fail("byte ", at(), ": it stores ", components, " components, expected grey, colours or inks (1, 3 or 4)");
    }
    const PictureSize size = {cinfo_.image_width, cinfo_.image_height, components};
    check_size(size, at());
    check_decoded_size(size, at());
    return size;
  }

  Picture read() {
    const PictureSize size = header();
    const bool inks = size.channels == 4;
    Picture picture;
    picture.width = size.width;
    picture.height = size.height;
    picture.channels = size.channels == 1 ? 1 : 3;
    const auto stride = static_cast<size_t>(size.width * size.channels);
    std::vector<uint8_t> row(inks ? stride : 0);
    picture.samples8.resize(static_cast<size_t>(size.width * size.height * picture.channels));
    uint8_t* out = picture.samples8.data();
    guarded([this, inks, out, to = row.data()] {
      cinfo_.out_color_space = inks ? JCS_CMYK : cinfo_.num_components == 1 ? JCS_GRAYSCALE : JCS_RGB;
      jpeg_start_decompress(&cinfo_);
      const size_t width = cinfo_.output_width, channels = cinfo_.num_components == 1 ? 1 : 3;
      while (cinfo_.output_scanline < cinfo_.output_height) {
        uint8_t* here = out + cinfo_.output_scanline * width * channels;
        JSAMPROW target = inks ? to : here;
        jpeg_read_scanlines(&cinfo_, &target, 1);
        if (inks) to_colours(to, width, here);
      }
      jpeg_finish_decompress(&cinfo_);
    });
    return picture;
  }

 private:
  // What says nothing against the picture: bytes between segments, versions and colour transforms that are not known.
  static bool is_harmless(int code) {
    return code == JWRN_EXTRANEOUS_DATA || code == JWRN_JFIF_MAJOR || code == JWRN_ADOBE_XFORM ||
           code == JWRN_BOGUS_ICC;
  }

  [[noreturn]] static void leave(j_common_ptr cinfo) {
    auto* self = static_cast<JpegReader*>(cinfo->client_data);
    if (cinfo->err->msg_code == JWRN_JPEG_EOF || cinfo->err->msg_code == JERR_INPUT_EOF) {
      self->message_ = "the file is cut short";
      self->cinfo_.src->bytes_in_buffer = 0;  // of which it may have taken some already
    } else {
      cinfo->err->format_message(cinfo, self->text_);
      self->message_ = self->text_;
    }
    std::longjmp(self->back_, 1);
  }

  // Runs functions of libjpeg, which leave by `longjmp` where they fail. So `work` makes nothing that has a destructor.
  template <class Work>
  void guarded(const Work& work) {
    if (setjmp(back_) != 0) fail("byte ", at(), ": ", message_);
    work();
  }

  size_t at() const { return file_.size() - (cinfo_.src ? cinfo_.src->bytes_in_buffer : file_.size()); }

  // Inks are stored as how much light they let through: so Adobe's programs began, and all others follow.
  static void to_colours(const uint8_t* inks, size_t width, uint8_t* out) {
    for (size_t i = 0; i < width; ++i) {
      const uint8_t* ink = inks + 4 * i;
      for (size_t c = 0; c < 3; ++c) out[3 * i + c] = static_cast<uint8_t>((ink[c] * ink[3] + 127) / 255);
    }
  }

  std::span<const uint8_t> file_;
  jpeg_decompress_struct cinfo_ = {};
  jpeg_error_mgr errors_ = {};
  jpeg_progress_mgr progress_ = {};
  std::jmp_buf back_ = {};
  char text_[JMSG_LENGTH_MAX] = {};
  const char* message_ = text_;
};

}  // namespace

PictureSize check_jpeg(std::span<const uint8_t> file) { return JpegReader(file).header(); }
Picture decode_jpeg(std::span<const uint8_t> file) { return JpegReader(file).read(); }

}  // namespace dr::io
