// SPDX-License-Identifier: Apache-2.0
// Values of symbols, and the sizes that extents have with them.
#pragma once

#include <cstdint>
#include <map>
#include <string>

#include "compiler/backend/bundle/bundle.h"
#include "compiler/io/array/array.h"
#include "compiler/ir/dim.h"

namespace dr::runtime {

inline constexpr int64_t kMaxElements = int64_t{1} << 31;

struct Size {
  int64_t w = 1, h = 1, l = 1;
  int64_t count() const { return w * h * l; }
};

int components_of(const bundle::TypeT& type);
io::ElementKind kind_of(const bundle::TypeT& type);

// Both of these throw Failure, with `what` as the thing that has the extent.
class Sizes {
 public:
  // Fails when the symbol has another value already; `origin` says where this one comes from.
  void set(const std::string& symbol, int64_t value, const std::string& origin);
  int64_t evaluate(const std::string& expression, const std::string& what) const;
  Size size_of(const bundle::ExtentT& extent, const std::string& what) const;
  const ir::SymbolValues& symbols() const { return symbols_; }

 private:
  std::string where(const ir::Dim& dim) const;  // what the symbols are, and why

  ir::SymbolValues symbols_;
  std::map<std::string, std::string, std::less<>> origins_;
};

}  // namespace dr::runtime
