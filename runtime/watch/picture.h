// SPDX-License-Identifier: Apache-2.0
// Arrays as pictures for a screen.
#pragma once

#include <optional>
#include <string>

#include "compiler/io/array/array.h"

namespace dr::watch {

struct Picture {
  int width = 0, height = 0;
  int layer = 0, layers = 1;
  std::string pixels;  // four bytes each
  std::string note;    // what black and white are, where they are not 0 and 1
};

// Whether it has an extent that shows as a picture.
bool is_picture(const io::Array& array);

// A layer, no side longer than `most`: of larger arrays every so many elements. Three and four components are linear
// colours, which get the sRGB curve; one or two are data, which go from black to white between the least and the
// greatest, where they leave 0 to 1.
Picture picture_of(const io::Array& array, int layer, int most);

}  // namespace dr::watch
