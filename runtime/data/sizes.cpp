// SPDX-License-Identifier: Apache-2.0
// Symbols and extents.
#include "runtime/data/sizes.h"

#include <algorithm>

#include "runtime/data/failure.h"

namespace dr::runtime {

int components_of(const bundle::TypeT& type) { return type.rows * type.cols; }

io::ElementKind kind_of(const bundle::TypeT& type) {
  switch (type.scalar) {
    case bundle::Scalar::Bool: return io::ElementKind::Bool;
    case bundle::Scalar::Int: return io::ElementKind::Int32;
    case bundle::Scalar::Uint: return io::ElementKind::UInt32;
    case bundle::Scalar::Float: break;
  }
  return io::ElementKind::Float32;
}

void Sizes::set(const std::string& symbol, int64_t value, const std::string& origin) {
  const auto it = symbols_.find(symbol);
  if (it == symbols_.end()) {
    symbols_[symbol] = value;
    origins_[symbol] = origin;
  } else if (it->second != value && origins_[symbol] == origin) {
    throw Failure{"'" + symbol + "' is " + std::to_string(it->second) + " since " + origin + " was first bound, but " +
                  std::to_string(value) + " now: a run keeps its sizes, so others take another run"};
  } else if (it->second != value) {
    throw Failure{"'" + symbol + "' is " + std::to_string(it->second) + " by " + origins_[symbol] + ", but " +
                  std::to_string(value) + " by " + origin};
  }
}

int64_t Sizes::evaluate(const std::string& expression, const std::string& what) const {
  const auto dim = ir::Dim::parse(expression);
  const auto value = dim ? dim->evaluate(symbols_) : std::nullopt;
  if (!value) throw Failure{"the extent '" + expression + "' of " + what + " has no value: bind its symbols"};
  if (*value < 1 || *value > kMaxElements)
    throw Failure{"the extent '" + expression + "' of " + what + " is " + std::to_string(*value) +
                  ", which is not between 1 and 2^31" + where(*dim)};
  return *value;
}

std::string Sizes::where(const ir::Dim& dim) const {
  std::string out;
  for (const std::string& symbol : dim.symbols()) {
    const auto origin = origins_.find(symbol);
    out += (out.empty() ? ", where '" : ", '") + symbol + "' is " + std::to_string(symbols_.at(symbol)) +
           (origin == origins_.end() ? "" : " by " + origin->second);
  }
  return out;
}

Size Sizes::size_of(const bundle::ExtentT& e, const std::string& what) const {
  const Size s{evaluate(e.w, what), evaluate(e.h, what), evaluate(e.l, what)};
  if (s.w > kMaxElements / s.h || s.w * s.h > kMaxElements / s.l) throw Failure{what + " has more than 2^31 elements"};
  return s;
}

}  // namespace dr::runtime
