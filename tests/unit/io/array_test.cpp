// SPDX-License-Identifier: Apache-2.0
// Host arrays: extents, views and conversions.

#include "compiler/io/array/array.h"

#include <limits>

#include "tests/catch.h"

namespace dr::io {
namespace {

TEST_CASE("an array knows its extent", "[io][array]") {
  const Array array = Array::from_floats(std::vector<float>{1, 2, 3, 4, 5, 6}, 3);
  CHECK(array.width == 2);
  CHECK(array.size() == 2);
  CHECK(array.scalar_count() == 6);
  CHECK(array.consistent());
  CHECK(array.as<float>()[5] == 6);

  const Array picture = Array::zeros(ElementKind::Bool, 1, 4, 3, 2);
  CHECK(picture.size() == 24);
  CHECK(picture.bytes.size() == 24);

  CHECK(Array().empty());
  CHECK_FALSE(Array().consistent());
}

TEST_CASE("an extent whose product wraps around is not consistent", "[io][array]") {
  Array array;
  array.width = int64_t{1} << 32;
  array.height = int64_t{1} << 32;
  CHECK_FALSE(array.consistent());
  array.width = -1;
  array.height = -1;
  array.bytes.resize(4);
  CHECK_FALSE(array.consistent());
}

TEST_CASE("scalars of any kind become doubles and floats", "[io][array]") {
  Array bools = Array::zeros(ElementKind::Bool, 1, 2);
  bools.bytes[1] = std::byte{1};
  CHECK(bools.to_doubles() == std::vector<double>{0, 1});
  CHECK(Array::from_ints(std::vector<int32_t>{-7}).to_doubles() == std::vector<double>{-7});
  CHECK(Array::from_doubles(std::vector<double>{0.5}).to_floats() == std::vector<float>{0.5f});
}

TEST_CASE("an array is made of each kind of scalars", "[io][array]") {
  const bool flags[] = {true, false, true};
  const Array bools = Array::from<bool>(flags, 1, 0, 1, 1);
  CHECK(bools.kind == ElementKind::Bool);
  CHECK(bools.to_doubles() == std::vector<double>{1, 0, 1});
  CHECK(bools.as<bool>()[2]);
  const uint32_t words[] = {4294967295u, 2};
  CHECK(Array::from<uint32_t>(words, 2, 0, 1, 1).width == 1);
}

TEST_CASE("a conversion that would lose something is refused", "[io][array]") {
  const Array floats = Array::from_floats(std::vector<float>{0, 1, 3});
  REQUIRE(floats.converted(ElementKind::Int32).ok());
  CHECK(floats.converted(ElementKind::Int32)->as<int32_t>()[2] == 3);
  CHECK(floats.converted(ElementKind::Float64)->to_doubles() == std::vector<double>{0, 1, 3});
  CHECK(floats.converted(ElementKind::Bool).error() == "cannot turn float32 into bool: scalar 2 is 3");

  const Array half = Array::from_floats(std::vector<float>{0.5f});
  CHECK(half.converted(ElementKind::UInt32).error() == "cannot turn float32 into uint32: scalar 0 is 0.5");
  const Array negative = Array::from_ints(std::vector<int32_t>{4, -1});
  CHECK(negative.converted(ElementKind::UInt32).error() == "cannot turn int32 into uint32: scalar 1 is -1");
  const Array large = Array::from_doubles(std::vector<double>{1e300});
  CHECK(large.converted(ElementKind::Float32).error() == "cannot turn float64 into float32: scalar 0 is 1e+300");
  const Array nan = Array::from_doubles(std::vector<double>{std::numeric_limits<double>::quiet_NaN()});
  CHECK(nan.converted(ElementKind::Float32).ok());
  CHECK_FALSE(nan.converted(ElementKind::Int32).ok());
}

}  // namespace
}  // namespace dr::io
