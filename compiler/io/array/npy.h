// SPDX-License-Identifier: Apache-2.0
// NumPy's .npy files, .csv tables and JSON literals: numbers with a shape. Private to compiler/io; every function
// throws Failure.
#pragma once

#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "compiler/io/array/array.h"
#include "compiler/io/file/file.h"

namespace dr::io {

// The extent that a shape means, by the rule of load_binding.
struct Extent {
  int components = 1;
  int64_t width = 1;
  int64_t height = 1;
  int64_t layers = 1;
};
Extent extent_of_shape(std::span<const int64_t> shape, int expected_components);

// "(64, 128, 3)"
std::string shape_text(std::span<const int64_t> shape);

// Half floats become float32; integers of other widths become int32 or uint32 when they fit, else it is an error.
Array parse_npy(std::span<const uint8_t> file, int expected_components);
Bytes encode_npy(const Array& array);

// `text` is JSON: a number, a bool or nested lists of them. All integers give int32, all bools bool, others float64.
Array parse_literal(std::string_view text, int expected_components);

// A table of numbers, a line a row; a first line that is not all numbers is a heading. Rows by columns are the shape, a
// single column is a list.
Array parse_csv(std::string_view text, int expected_components);
// A list gives a line an element, a picture of one component a line a row; fails for what is no table.
Bytes encode_csv(const Array& array);

}  // namespace dr::io
