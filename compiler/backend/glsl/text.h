// SPDX-License-Identifier: Apache-2.0
// Small helpers of the GLSL printer: an indenting writer, literals, and extents as expressions.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "compiler/ir/graph.h"

namespace dr::backend::glsl {

// Text with indentation by braces: a line that ends in '{' indents what follows, one that starts with '}' ends it.
class Writer {
 public:
  explicit Writer(int depth = 0) : depth_(depth) {}
  void line(std::string_view text);
  std::string take() { return std::move(out_); }

 private:
  std::string out_;
  int depth_;
};

// GLSL names of symbols: prefixed, because any name may be a keyword, a macro or one of ours.
std::string symbol_name(std::string_view symbol);
// A Dim as a GLSL expression that needs no parentheses around it. The host computes, in 64 bits, the divisions in it
// that may need more than 32 on the way: each is a constant of a name of its own.
std::string dim_expression(const ir::Dim& dim);
// The divisions of the host's whose names stand in a text, as extents, in the order of their names.
std::vector<ir::Dim> host_divisions(std::string_view text);
std::string division_name(const ir::Dim& division);
// Components as a literal of the type, exact for float32. `zero`, unless empty, stands for those that are zero.
std::string literal(const ir::Type& type, std::span<const double> components, std::string_view zero = {});
std::string zero(const ir::Type& type);
// What every value is at most (`least`) or at least: where a minimum or a maximum starts.
std::string limit(const ir::Type& type, bool least);
// Component `c` of a variable, in the order of storage.
std::string component(const ir::Type& type, const std::string& name, int c);
// The type's scalar in a storage buffer (Bool is uint), and a buffer word <-> component.
std::string storage_scalar(ir::Scalar scalar);
// A user's name made fit for GLSL, without the number that makes it unique.
std::string sanitize(std::string_view name);
// The shader with numbers for the names made of a program's, which end in _NUMBER or _NUMBER_block: equal for shaders
// that are equal but for these names, since each new one gets the next number.
std::string without_names(std::string_view source);

}  // namespace dr::backend::glsl
