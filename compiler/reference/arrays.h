// SPDX-License-Identifier: Apache-2.0
// Between host arrays, element by element, and the evaluator's images, plane by plane.
#pragma once

#include "compiler/io/array/array.h"
#include "compiler/reference/evaluate.h"

namespace dr::reference {

// Of arrays that hold a type's values; floats as they were computed, in float64.
io::ElementKind kind_of(ir::Scalar scalar);

// Precondition: an element of the array has as many components as the type.
Image to_image(const io::Array& array, const ir::Type& type);

// Fails on an integer that its type cannot hold.
io::Result<io::Array> to_array(const Image& image);

// The first element with a component that is NaN or Inf, if there is one.
std::optional<io::Place> first_not_finite(const Image& image);

}  // namespace dr::reference
