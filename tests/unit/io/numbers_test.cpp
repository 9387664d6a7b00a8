// SPDX-License-Identifier: Apache-2.0
// .npy files and JSON literals: how shapes become extents and scalars become kinds.

#include "compiler/io/array/array.h"
#include "tests/catch.h"
#include "tests/unit/io/support.h"

namespace dr::io {
namespace {

using namespace test;

std::vector<int64_t> extent(const Result<Array>& array) {
  INFO((array.ok() ? std::string() : array.error()));
  REQUIRE(array.ok());
  REQUIRE(array->consistent());
  return {array->layers, array->height, array->width, array->components};
}

using Shape = std::vector<int64_t>;

TEST_CASE("the shape of a .npy file fills the extent from its end", "[io][npy]") {
  const TemporaryFolder folder;
  const std::string flat = folder.write("a.npy", npy_file("<f4", "(2, 3)", f32({1, 2, 3, 4, 5, 6})));
  CHECK(extent(load_binding(flat)) == Shape{1, 2, 3, 1});
  CHECK(extent(load_binding(flat, 1)) == Shape{1, 2, 3, 1});
  CHECK(extent(load_binding(flat, 3)) == Shape{1, 1, 2, 3});

  const std::string deep = folder.write("b.npy", npy_file("<f4", "(1, 2, 1, 3)", f32({1, 2, 3, 4, 5, 6})));
  CHECK(extent(load_binding(deep)) == Shape{1, 2, 1, 3});
  CHECK(extent(load_binding(deep, 3)) == Shape{1, 2, 1, 3});

  const std::string layers = folder.write("c.npy", npy_file("<f4", "(3, 1, 2)", f32({1, 2, 3, 4, 5, 6})));
  CHECK(extent(load_binding(layers, 1)) == Shape{3, 1, 2, 1});
  CHECK(extent(load_binding(layers, 2)) == Shape{1, 3, 1, 2});

  const std::string scalar = folder.write("d.npy", npy_file("<f4", "()", f32({7})));
  CHECK(extent(load_binding(scalar)) == Shape{1, 1, 1, 1});
  const std::string row = folder.write("e.npy", npy_file("<f4", "(2,)", f32({7, 8})));
  CHECK(extent(load_binding(row)) == Shape{1, 1, 2, 1});
  CHECK(extent(load_binding(row, 2)) == Shape{1, 1, 1, 2});
}

TEST_CASE("a .npy file may hold scalars of other widths and byte orders", "[io][npy]") {
  const TemporaryFolder folder;
  const auto load = [&](std::string_view descr, std::string_view data) {
    Result<Array> array = load_binding(folder.write("x.npy", npy_file(descr, "(2,)", data)));
    INFO((array.ok() ? std::string() : array.error()));
    REQUIRE(array.ok());
    return std::move(*array);
  };
  CHECK(load("<f2", u16({0x3c00, 0xc100})).to_doubles() == std::vector<double>{1, -2.5});
  CHECK(load("<f2", u16({0x0001, 0x7bff})).to_doubles() == std::vector<double>{0x1p-24, 65504});
  CHECK(load(">u2", std::string("\x01\x00\x00\x02", 4)).to_doubles() == std::vector<double>{256, 2});
  CHECK(load(">u2", std::string("\x01\x00\x00\x02", 4)).kind == ElementKind::UInt32);
  CHECK(load("|i1", "\xff\x7f").to_doubles() == std::vector<double>{-1, 127});
  CHECK(load("<i8", u32({0xfffffffe, 0xffffffff, 5, 0})).to_doubles() == std::vector<double>{-2, 5});
  CHECK(load("|b1", std::string("\x01\x00", 2)).kind == ElementKind::Bool);
  CHECK(load("<f8", u32({0, 0x3ff80000, 0, 0xc0000000})).to_doubles() == std::vector<double>{1.5, -2});
  CHECK(load("<f8", u32({0, 0x3ff80000, 0, 0xc0000000})).kind == ElementKind::Float64);
}

TEST_CASE("arrays of every kind survive a .npy file", "[io][npy]") {
  const TemporaryFolder folder;
  const std::string path = folder / "x.npy";
  for (const ElementKind kind :
       {ElementKind::Float32, ElementKind::Float64, ElementKind::Int32, ElementKind::UInt32, ElementKind::Bool}) {
    for (const int components : {1, 3, 16}) {
      for (const Shape& sides : {Shape{1, 1, 1}, Shape{1, 1, 5}, Shape{1, 2, 5}, Shape{3, 2, 5}, Shape{3, 1, 1}}) {
        Array array = Array::zeros(kind, components, sides[2], sides[1], sides[0]);
        for (size_t i = 0; i < array.bytes.size(); ++i) {
          array.bytes[i] = static_cast<std::byte>(kind == ElementKind::Bool ? i % 2 : i * 7 % 64);
        }
        REQUIRE(save_array(path, array).ok());
        const Result<Array> back = load_binding(path, components);
        CHECK(extent(back) == Shape{sides[0], sides[1], sides[2], components});
        CHECK(back->kind == kind);
        CHECK(back->bytes == array.bytes);
      }
    }
  }
}

TEST_CASE("the header of a written .npy file is what NumPy writes", "[io][npy]") {
  const TemporaryFolder folder;
  REQUIRE(save_array(folder / "x.npy", Array::from_floats(std::vector<float>(30), 3, 5, 2)).ok());
  const std::string text = read_text(folder / "x.npy");
  CHECK(text.substr(0, 8) == std::string("\x93NUMPY\x01\x00", 8));
  CHECK(text.substr(10, 59) == "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 5, 3)");
  CHECK(text.size() == 128 + 120);
  CHECK(text[127] == '\n');
}

TEST_CASE("literals are numbers and nested lists", "[io][literal]") {
  CHECK(extent(load_binding("=3.5")) == Shape{1, 1, 1, 1});
  CHECK(load_binding("=3.5")->as<double>()[0] == 3.5);
  CHECK(extent(load_binding("=[1, 2, 3]")) == Shape{1, 1, 3, 1});
  CHECK(extent(load_binding("=[1, 2, 3]", 3)) == Shape{1, 1, 1, 3});
  CHECK(load_binding("=[1, 2, 3]")->kind == ElementKind::Int32);
  CHECK(load_binding("=[1, 2.0, 3]")->kind == ElementKind::Float64);
  CHECK(load_binding("=[1, 3000000000]")->kind == ElementKind::Float64);
  CHECK(load_binding("=[true, false]")->kind == ElementKind::Bool);
  CHECK(extent(load_binding("=[[1, 2], [3, 4]]")) == Shape{1, 2, 2, 1});
  CHECK(extent(load_binding("=[[1, 2], [3, 4]]", 2)) == Shape{1, 1, 2, 2});
  CHECK(extent(load_binding("=[[[1], [2]], [[3], [4]]]")) == Shape{2, 2, 1, 1});
  CHECK(extent(load_binding("=[[[[1, 2]]], [[[3, 4]]]]", 2)) == Shape{2, 1, 1, 2});
  CHECK(load_binding("=[[1, 2], [3, 4]]", 2)->to_doubles() == std::vector<double>{1, 2, 3, 4});
}

TEST_CASE("the mark before a literal may be left out", "[io][literal]") {
  CHECK(load_binding("0.25")->to_doubles() == std::vector<double>{0.25});
  CHECK(load_binding("-1e3")->to_doubles() == std::vector<double>{-1000});
  CHECK(load_binding("[1,2]")->to_doubles() == std::vector<double>{1, 2});
  CHECK(load_binding("true")->kind == ElementKind::Bool);
}

}  // namespace
}  // namespace dr::io
