// SPDX-License-Identifier: Apache-2.0
// Pictures: the sRGB curve, channel selectors, bit depths, stacks, and PNG files written and read back.

#include <cmath>

#include "compiler/io/array/array.h"
#include "tests/catch.h"
#include "tests/unit/io/support.h"

namespace dr::io {
namespace {

using namespace test;

Array load_array(const std::string& source, int expected_components = 0) {
  Result<Array> array = load_binding(source, expected_components);
  INFO((array.ok() ? std::string() : array.error()));
  REQUIRE(array.ok());
  REQUIRE(array->kind == ElementKind::Float32);
  REQUIRE(array->consistent());
  return std::move(*array);
}

std::vector<float> floats(const Array& array) { return array.to_floats(); }

// The sRGB curve as its standard states it.
float linear(int value) {
  const double s = value / 255.0;
  return static_cast<float>(s <= 0.04045 ? s / 12.92 : std::pow((s + 0.055) / 1.055, 2.4));
}
float raw(int value) { return static_cast<float>(value / 255.0); }

// One row of bytes with its filter byte.
std::string row(std::initializer_list<int> bytes) {
  std::string out(1, '\0');
  for (const int byte : bytes) out += static_cast<char>(byte);
  return out;
}

TEST_CASE("colour is made linear and alpha is not", "[io][image]") {
  const TemporaryFolder folder;
  const std::string path =
      folder.write("a.png", png_file(1, 2, 8, 6, row({0, 128, 255, 64}) + row({10, 11, 200, 255})));
  const Array array = load_array(path);
  CHECK(array.components == 4);
  CHECK(array.width == 1);
  CHECK(array.height == 2);
  // The first row of the file is y = 0.
  CHECK(floats(array) == std::vector<float>{0, linear(128), 1, raw(64), linear(10), linear(11), linear(200), 1});
  CHECK(floats(load_array(path + ":raw")) ==
        std::vector<float>{0, raw(128), 1, raw(64), raw(10), raw(11), raw(200), 1});
  CHECK(floats(load_array(path + ":rgb")) ==
        std::vector<float>{0, linear(128), 1, linear(10), linear(11), linear(200)});
  CHECK(floats(load_array(path + ":a")) == std::vector<float>{raw(64), 1});
  CHECK(floats(load_array(path + ":r")) == std::vector<float>{0, linear(10)});
  CHECK(floats(load_array(path + ":raw:r")) == std::vector<float>{0, raw(10)});
  CHECK(floats(load_array(path + ":r:raw")) == std::vector<float>{0, raw(10)});
}

TEST_CASE("grey is data unless it is asked for as a colour", "[io][image]") {
  const TemporaryFolder folder;
  const std::string grey = folder.write("grey.png", png_file(2, 1, 8, 0, row({128, 255})));
  CHECK(floats(load_array(grey, 1)) == std::vector<float>{raw(128), 1});
  CHECK(floats(load_array(grey + ":r")) == std::vector<float>{raw(128), 1});
  CHECK(floats(load_array(grey + ":rgb")) == std::vector<float>{linear(128), linear(128), linear(128), 1, 1, 1});
  CHECK(floats(load_array(grey + ":raw:rgba")) == std::vector<float>{raw(128), raw(128), raw(128), 1, 1, 1, 1, 1});

  const std::string both = folder.write("both.png", png_file(1, 1, 8, 4, row({128, 7})));
  CHECK(floats(load_array(both)) == std::vector<float>{raw(128), raw(7)});
  CHECK(floats(load_array(both + ":a")) == std::vector<float>{raw(7)});
  CHECK(floats(load_array(both + ":rgba")) == std::vector<float>{linear(128), linear(128), linear(128), raw(7)});
}

TEST_CASE("a colour without alpha is opaque for :rgba", "[io][image]") {
  const TemporaryFolder folder;
  const std::string path = folder.write("a.png", png_file(1, 1, 8, 2, row({1, 2, 3})));
  CHECK(load_array(path).components == 3);
  CHECK(floats(load_array(path + ":raw:rgba", 4)) == std::vector<float>{raw(1), raw(2), raw(3), 1});
}

TEST_CASE("16-bit pictures keep their depth, small depths are scaled", "[io][image]") {
  const TemporaryFolder folder;
  const std::string deep = folder.write("deep.png", png_file(1, 1, 16, 0, row({0x80, 0x01})));
  CHECK(floats(load_array(deep)) == std::vector<float>{static_cast<float>(0x8001 / 65535.0)});
  const std::string mask = folder.write("mask.png", png_file(4, 1, 1, 0, row({0xa0})));
  CHECK(floats(load_array(mask)) == std::vector<float>{1, 0, 1, 0});
}

TEST_CASE("a palette gives colours, with alpha where the file has it", "[io][image]") {
  const TemporaryFolder folder;
  const std::string whole = png_file(2, 1, 8, 3, row({1, 0}));
  const size_t header = png_header(2, 1, 8, 3).size();
  const std::string palette = png_chunk("PLTE", std::string("\x00\x00\x00\xff\x80\x00", 6));
  const std::string path = folder.write("p.png", whole.substr(0, header) + palette + whole.substr(header));
  CHECK(floats(load_array(path)) == std::vector<float>{1, linear(128), 0, 0, 0, 0});
  const std::string alpha = png_chunk("tRNS", std::string("\x00", 1));
  const std::string clear = folder.write("t.png", whole.substr(0, header) + palette + alpha + whole.substr(header));
  CHECK(floats(load_array(clear)) == std::vector<float>{1, linear(128), 0, 1, 0, 0, 0, 0});

  // Of 2 bits: the first four of twelve pixels name the colours 2, 1, 0 and 1.
  const auto file = [&](uint8_t bits, const std::string& chunks, std::initializer_list<int> bytes) {
    const std::string plain = png_file(4, 1, bits, 3, row(bytes));
    return folder.write("b.png", plain.substr(0, header) + chunks + plain.substr(header));
  };
  const std::string three = png_chunk("PLTE", std::string("\x00\x00\x00\xff\x80\x00\x01\x02\x03", 9));
  CHECK(floats(load_array(file(2, three, {0x91}) + ":raw:r")) == std::vector<float>{raw(1), 1, 0, 1});
  const auto refusal = [&](const std::string& of) { return replaced(load_binding(of).error(), folder.path(), ""); };
  CHECK(refusal(file(2, three, {0x93})) ==
        "cannot read '/b.png': the pixel at x 3, y 0 has the colour 3 of a palette of 3");
  CHECK(refusal(file(8, three, {0, 1, 200, 3})) ==
        "cannot read '/b.png': the pixel at x 2, y 0 has the colour 200 of a palette of 3");
  CHECK(refusal(file(8, "", {0, 1, 2, 3})) == "cannot read '/b.png': there is no palette before the picture data");
  CHECK(refusal(file(8, png_chunk("PLTE", "1234"), {0, 0, 0, 0})) ==
        "cannot read '/b.png': byte 33: a palette of 4 bytes, expected 1 to 256 colours of 3");
  CHECK(refusal(file(8, three + png_chunk("tRNS", "1234"), {0, 0, 0, 0})) ==
        "cannot read '/b.png': byte 54: 4 alphas for a palette of 3");
  CHECK(refusal(file(16, three, {0, 0, 0, 0, 0, 0, 0, 0})) ==
        "cannot read '/b.png': byte 24: a picture with a palette has at most 8 bits, found 16");
}

TEST_CASE("a JPEG is read by content, whatever its extension", "[io][image]") {
  const TemporaryFolder folder;
  for (const std::string_view name : {"a.jpg", "b.jpeg", "c.JPG", "d.png"}) {
    const Array array = load_array(folder.write(name, jpeg_file()) + ":raw", 3);
    CHECK(array.width == 16);
    CHECK(array.height == 8);
    const auto scalars = array.as<float>();
    CHECK(scalars[0] == Approx(200 / 255.0).margin(0.03));
    CHECK(scalars[15 * 3 + 2] == Approx(220 / 255.0).margin(0.03));
  }
}

TEST_CASE("a file's name may hold a colon", "[io][image]") {
  const TemporaryFolder folder;
  const std::string path = folder.write("a:b.jpg", jpeg_file());
  CHECK(load_array(path, 3).width == 16);
  CHECK(load_array(path + ":raw:r", 1).width == 16);
}

TEST_CASE("a JPEG gives libjpeg's numbers, whatever it stores", "[io][image]") {
  const TemporaryFolder folder;
  // Colours at half the width, as cameras store them: what Pillow 11 reads in row 4 beside a sharp edge.
  const Array edge = load_array(folder.write("a.jpg", jpeg_of_half_width()) + ":raw", 3);
  const std::vector<int> expected = {253, 2, 0, 203, 14, 72, 50, 0, 177, 2, 1, 255};
  for (size_t i = 0; i < expected.size(); ++i) {
    CHECK(std::lround(edge.as<float>()[(4 * 16 + 12) * 3 + i] * 255) == expected[i]);
  }
  // Inks, of which there are four, with Adobe's marker and without it.
  const std::string inks = jpeg_of_inks();
  for (const std::string& file : {inks, inks.substr(0, 2) + inks.substr(18)}) {
    const Array colours = load_array(folder.write("b.jpg", file) + ":raw", 3);
    CHECK(std::lround(colours.as<float>()[0] * 255) == 204);
    CHECK(colours.as<float>()[1] == 0);
    CHECK(colours.as<float>()[2] == 0);
  }
}

TEST_CASE("HDR pictures are linear as stored", "[io][image]") {
  const TemporaryFolder folder;
  const Array array = load_array(folder.write("a.hdr", hdr_file()), 3);
  CHECK(array.width == 8);
  CHECK(array.height == 2);
  const auto scalars = array.as<float>();
  CHECK(scalars[0] == 1);
  CHECK(scalars[1] == 0.5f);
  CHECK(scalars[2] == 0.25f);
  CHECK(scalars[8 * 3 + 3 * 3] == 3 / 16.0f);
  CHECK(floats(load_array(folder / "a.hdr:r"))[9] == 1 / 16.0f);

  // Without run-length coding, and with the old one: a pixel and a run of three more.
  const std::string header = "#?RGBE\n# comment\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=2\n\n-Y 1 +X 4\n";
  const std::string pixel = std::string("\x80\x40\x20\x82", 4);
  const std::vector<float> four = {2, 1, 0.5f, 2, 1, 0.5f, 2, 1, 0.5f, 2, 1, 0.5f};
  CHECK(floats(load_array(folder.write("flat.hdr", header + pixel + pixel + pixel + pixel))) == four);
  CHECK(floats(load_array(folder.write("old.hdr", header + pixel + std::string("\x01\x01\x01\x03", 4)))) == four);
}

TEST_CASE("a pattern stacks pictures in the order of their names", "[io][image]") {
  const TemporaryFolder folder;
  folder.write("v/b.png", png_file(1, 1, 8, 0, row({51})));
  folder.write("v/a.png", png_file(1, 1, 8, 0, row({0})));
  folder.write("v/c10.png", png_file(1, 1, 8, 0, row({255})));
  folder.write("v/.hidden.png", "not a picture");
  folder.write("v/notes.txt", "not a picture");
  const Array array = load_array(folder / "v/*.png", 1);
  CHECK(array.layers == 3);
  CHECK(floats(array) == std::vector<float>{0, 0.2f, 1});
  CHECK(load_array(folder / "v/?.png").layers == 2);
  CHECK(load_array(folder / "v/c*0*.png:raw").layers == 1);
}

TEST_CASE("a stack of grey and colour pictures has one meaning", "[io][image]") {
  const TemporaryFolder folder;
  folder.write("m/a.png", png_file(1, 1, 8, 0, row({128})));
  folder.write("m/b.png", png_file(1, 1, 8, 2, row({128, 128, 128})));
  CHECK(floats(load_array(folder / "m/*.png:raw:r")) == std::vector<float>{raw(128), raw(128)});
  CHECK(floats(load_array(folder / "m/*.png:rgb"))[3] == linear(128));
  CHECK(replaced(load_binding(folder / "m/*.png:r").error(), folder.path(), "") ==
        "cannot read '/m/*.png:r': '/m/b.png': it stores rgb, '/m/a.png' stores grey, and the sRGB curve is undone for "
        "the colour alone; ':raw:r' takes all as stored, ':rgb' as colours");
}

TEST_CASE("a picture survives a PNG file", "[io][image]") {
  const TemporaryFolder folder;
  const std::string path = folder / "x.png";
  for (const int components : {1, 2, 3, 4}) {
    std::vector<float> values;
    for (int i = 0; i < 256 * components; ++i) {
      const bool curved = components >= 3 && i % components < 3;
      values.push_back(curved ? linear(i / components) : raw(i / components));
    }
    const Array array = Array::from_floats(values, components, 32, 8);
    REQUIRE(save_array(path, array).ok());
    const Array back = load_array(path, components);
    CHECK(back.width == 32);
    CHECK(back.height == 8);
    CHECK(floats(back) == values);
  }
}

TEST_CASE("layers become files that a pattern reads back in order", "[io][image]") {
  const TemporaryFolder folder;
  std::vector<float> values;
  for (int i = 0; i < 12; ++i) values.push_back(raw(i * 20));
  REQUIRE(save_array(folder / "x.png", Array::from_floats(values, 1, 1, 1, 12)).ok());
  CHECK(folder.names().front() == "x_00.png");
  CHECK(folder.names().back() == "x_11.png");
  const Array back = load_array(folder / "x_*.png");
  CHECK(back.layers == 12);
  CHECK(floats(back) == values);

  REQUIRE(save_array(folder / "y.png", Array::from_floats(std::vector<float>{0, 1}, 1, 1, 1, 2)).ok());
  CHECK(load_array(folder / "y_0.png").layers == 1);
}

TEST_CASE("values outside of 0 to 1 are clamped, bools are black and white", "[io][image]") {
  const TemporaryFolder folder;
  const float infinity = std::numeric_limits<float>::infinity();
  REQUIRE(save_array(folder / "x.png", Array::from_floats(std::vector<float>{-3, infinity, -infinity, 2})).ok());
  CHECK(floats(load_array(folder / "x.png")) == std::vector<float>{0, 1, 0, 1});
  Array mask = Array::zeros(ElementKind::Bool, 1, 2);
  mask.bytes[1] = std::byte{1};
  REQUIRE(save_array(folder / "m.png", mask).ok());
  CHECK(floats(load_array(folder / "m.png")) == std::vector<float>{0, 1});
  REQUIRE(save_array(folder / "d.png", Array::from_doubles(std::vector<double>{0.2})).ok());
  CHECK(floats(load_array(folder / "d.png")) == std::vector<float>{0.2f});
}

}  // namespace
}  // namespace dr::io
