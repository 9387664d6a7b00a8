// SPDX-License-Identifier: Apache-2.0
// Operands of library functions: random ones, and ones near those that were worst.
#pragma once

#include <cstdint>
#include <random>

#include "compiler/ir/type.h"
#include "tests/device/accuracy/library.h"

namespace dr::accuracy::library {

class Draw {
 public:
  explicit Draw(uint64_t seed) : engine_(seed) {}
  size_t pick(size_t count) { return static_cast<size_t>(engine_() % count); }
  double uniform(double low, double high);
  // The components of one element.
  std::vector<double> element(const Operand& o, const ir::Type& type);
  // An adjoint: numbers of both signs around 1, for one component alone unless `all`.
  std::vector<double> adjoint(const ir::Type& type, bool all);
  // A component a little off: by a few last places or by a part of it, within the operand's domain.
  double near(const Operand& o, const ir::Type& type, double x);

 private:
  double number(const Operand& o, const ir::Type& type);
  std::mt19937_64 engine_;
};

}  // namespace dr::accuracy::library
