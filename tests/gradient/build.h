// SPDX-License-Identifier: Apache-2.0
// Building graphs for gradient tests: short forms of ops with attributes, regions from lambdas, seeded random data.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <random>
#include <string>
#include <vector>

#include "compiler/ir/graph.h"
#include "compiler/ops/emit.h"
#include "compiler/reference/evaluate.h"

namespace dr::gradient_test {

using ir::Builder;
using ir::Dim;
using ir::Extent;
using ir::Graph;
using ir::OpKind;
using ir::RegionId;
using ir::Type;
using ir::ValueId;
using ir::Yield;
using reference::Image;
using Images = std::map<std::string, Image>;

inline ir::Attrs ints(std::vector<int64_t> values) {
  ir::Attrs attrs;
  attrs.ints = std::move(values);
  return attrs;
}
inline ir::Attrs dims(const Extent& e) {
  ir::Attrs attrs;
  attrs.dims = {e.w, e.h, e.l};
  return attrs;
}

// A leaf of the graph under construction and the op that reads it.
ValueId leaf(Builder& b, const std::string& name, Type type, const Extent& extent);

using Body = std::function<std::vector<ValueId>()>;
using TripBody = std::function<std::vector<ValueId>(ValueId)>;
// `images` are the extents of the Scatter results.
std::vector<ValueId> make_if(Builder& b, ValueId condition, const Extent& domain, std::vector<Yield> yields,
                             const Body& then_body, const Body& else_body, const std::vector<Extent>& images = {});
std::vector<ValueId> make_reduce(Builder& b, ValueId begin, ValueId end, const Extent& domain,
                                 std::vector<Yield> yields, const TripBody& body,
                                 const std::vector<Extent>& images = {});

// A Fold of one sweep. The body gives the next states, and what ends the loop or an invalid id.
struct Trip {
  ValueId stop;
  std::vector<ValueId> next;
  std::vector<ValueId> scattered = {};  // index and value, for each image
};
using FoldBody = std::function<Trip(ValueId i, const std::vector<ValueId>& states)>;
std::vector<ValueId> make_fold(Builder& b, ValueId begin, ValueId end, const Extent& domain,
                               const std::vector<ValueId>& starts, const FoldBody& body, int64_t bound = -1,
                               const std::vector<Extent>& images = {});

// Sum of all elements and components: float, extent 1.
ValueId total(Builder& b, ValueId x);
// Inner product of two values of one type, over all elements: float, extent 1.
ValueId inner(Builder& b, ValueId x, ValueId y);
std::vector<ValueId> grad(Builder& b, ValueId y, ValueId seed, const std::vector<ValueId>& xs);
// How y changes where x moves along a value of its type and extent: the adjoint of what leads from a seed to x's.
ValueId jvp(Builder& b, ValueId y, ValueId x, ValueId along);

// Adds a step with these outputs.
void add_step(Graph& graph, const std::string& name, const std::vector<std::pair<std::string, ValueId>>& outputs);

// Uniform numbers that are the same on every platform.
class Random {
 public:
  explicit Random(uint64_t seed) : engine_(seed) {}
  double real(double low, double high) { return low + (high - low) * static_cast<double>(engine_() >> 11) * 0x1p-53; }
  int integer(int count) { return static_cast<int>(engine_() % static_cast<uint64_t>(count)); }
  bool chance(double p) { return real(0, 1) < p; }
  // Filled with numbers of [low, high); the extent must be constant.
  Image image(Type type, const Extent& extent, double low, double high);

 private:
  std::mt19937_64 engine_;
};

// Runs a step, which must succeed.
Images run(reference::Session& session, const std::string& step);
void bind_leaves(reference::Session& session, const Images& leaves);

}  // namespace dr::gradient_test
