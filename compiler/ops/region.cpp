// SPDX-License-Identifier: Apache-2.0
// The structured constructs: what their results are, given what their regions yield. Their adjoints are the business of
// compiler/passes/differentiate*.cpp.
#include <algorithm>

#include "compiler/ops/families.h"
#include "compiler/ops/rules.h"

namespace dr::ops {

using namespace rules;

namespace {

using ir::Graph;
using ir::RegionId;
using ir::Yield;

// The yields of one region, sorted to the results.
struct Yielded {
  std::optional<ResultType> index;  // of a Scatter of (index, value)
  ResultType value;                 // an accumulation where a Scatter has no index
};

// What a region yields from its yield `at` on.
std::variant<std::vector<Yielded>, std::string> yielded(const Graph& graph, const Attrs& attrs, RegionId region,
                                                        size_t at) {
  const auto& values = graph.region(region).yields;
  std::vector<Yielded> result;
  const auto next = [&]() -> std::optional<ResultType> {
    if (at == values.size()) return std::nullopt;
    const ir::ValueInfo& value = graph.value(values[at++]);
    return ResultType{.type = value.type, .extent = value.extent, .accumulation = value.accumulation};
  };
  for (const Yield how : attrs.yields) {
    Yielded yield;
    auto value = next();
    if (how == Yield::Scatter && value && !value->accumulation) {
      yield.index = value;
      value = next();
    }
    if (!value) return "a region yields too little";
    yield.value = *value;
    result.push_back(yield);
  }
  if (at != values.size()) return "a region yields too much";
  return result;
}

std::string expect_stretches(const ResultType& value, const Extent& domain) {
  return stretches_to(value.extent, domain) ? "" : words(value) + " does not stretch to the domain, " + domain.str();
}

// The k-th scattered image, behind the domain.
Extent image_extent(const Attrs& attrs, size_t scatter) {
  const size_t at = 3 + 3 * scatter;
  return {attrs.dims[at], attrs.dims[at + 1], attrs.dims[at + 2]};
}

std::string expect_scatter(const Yielded& yield, const Extent& domain, const Extent& image) {
  if (!yield.index)
    return yield.value.extent == image ? "" : "an accumulation of another extent than the result, " + image.str();
  const Type type = yield.index->type;
  if (type.scalar != Scalar::Int || type.is_matrix() || type.rows > 3)
    return "an index is int, ivec2 or ivec3, not " + type.str();
  if (type.rows == 1 && !image.h.is_one()) return "an int does not name a place of an image of height " + image.h.str();
  if (type.rows < 3 && !image.l.is_one() && image.l != domain.l) {
    return "elements of " + domain.l.str() + " layers do not each have one of " + image.l.str();
  }
  if (std::string wrong = expect_stretches(*yield.index, domain); !wrong.empty()) return wrong;
  return expect_stretches(yield.value, domain);
}

// What one yield makes of its value's type; a sentence where it does not take it.
std::variant<Type, std::string> combined(Yield how, Type type) {
  switch (how) {
    case Yield::Element: return type;
    case Yield::Sum:
      if (!accepts(kNumbers | kMatrices, type)) return "cannot sum " + type.str();
      return type;
    case Yield::Min:
    case Yield::Max:
      if (!accepts(kNumbers, type)) return "there is no order of " + type.str();
      return type;
    case Yield::ArgMin:
      if (!accepts(kNumbers, type) || !type.is_scalar()) return "argmin takes a scalar, not " + type.str();
      return ir::kInt;
    case Yield::Scatter:
      if (!accepts(kNumbers | kMatrices, type)) return "cannot sum " + type.str();
      return type;
  }
  DR_ICE("no such yield");
}

// The common part: all regions that yield for the results yield the same types for them, from their yield `at` on.
InferResult infer_yields(const GraphInferInput& in, std::span<const RegionId> regions, size_t at = 0) {
  size_t scatters = 0;
  for (const Yield how : in.attrs.yields) scatters += how == Yield::Scatter ? 1 : 0;
  if (in.attrs.yields.empty()) return "an op without results";
  if (std::string wrong = expect_dims(in.attrs, 3 + 3 * scatters); !wrong.empty()) return wrong;
  const Extent domain = extent_of(in.attrs);
  for (const ResultType& operand : in.operand_types) {
    if (std::string wrong = expect_stretches(operand, domain); !wrong.empty()) return wrong;
  }

  std::vector<ResultType> results(in.attrs.yields.size());
  for (size_t r = 0; r < regions.size(); ++r) {
    auto yields = yielded(in.graph, in.attrs, regions[r], at);
    if (auto* wrong = std::get_if<std::string>(&yields)) return std::move(*wrong);
    size_t scatter = 0;
    for (size_t k = 0; k < results.size(); ++k) {
      const Yielded& yield = std::get<std::vector<Yielded>>(yields)[k];
      const bool is_scatter = in.attrs.yields[k] == Yield::Scatter;
      const Extent extent = is_scatter ? image_extent(in.attrs, scatter++) : domain;
      std::string wrong = is_scatter ? expect_scatter(yield, domain, extent) : expect_stretches(yield.value, domain);
      if (!wrong.empty()) return wrong;
      auto type = combined(in.attrs.yields[k], yield.value.type);
      if (auto* no_type = std::get_if<std::string>(&type)) return std::move(*no_type);
      const ResultType result{.type = std::get<Type>(type), .extent = extent};
      if (r > 0 && results[k].type != result.type) {
        return "branches differ: " + results[k].type.str() + " and " + result.type.str();
      }
      results[k] = result;
    }
  }
  return results;
}

InferResult infer_if(const GraphInferInput& in) {
  if (in.operands.size() != 1 || in.regions.size() != 2) return "expected a condition and two regions";
  if (in.operand_types[0].type != ir::kBool) return "a condition is bool, not " + in.operand_types[0].type.str();
  for (const Yield how : in.attrs.yields) {
    if (how != Yield::Element && how != Yield::Scatter) return "an if yields elements and scatters";
  }
  return infer_yields(in, in.regions);
}

InferResult infer_reduce(const GraphInferInput& in) {
  if (in.operands.size() != 2 || in.regions.size() != 1) return "expected two bounds and one region";
  if (std::string wrong = expect_ints(in.attrs, 1); !wrong.empty()) return wrong;
  if (in.attrs.ints[0] < -1) return "a bound on the trips is a number of them, or -1";
  for (const ResultType& bound : in.operand_types) {
    if (bound.type != ir::kInt) return "a bound is int, not " + bound.type.str();
  }
  const auto& params = in.graph.region(in.regions[0]).params;
  if (params.size() != 1 || in.graph.value(params[0]).type != ir::kInt) return "the region has one parameter, int";
  for (const Yield how : in.attrs.yields) {
    if (how == Yield::Element) return "a reduce combines what its trips yield";
  }
  return infer_yields(in, in.regions);
}

// The states of one sweep: of one type at its start, in every region that has them, and as it yields them.
std::string expect_states(const GraphInferInput& in, size_t sweep, size_t first, const Extent& domain) {
  const auto count = static_cast<size_t>(in.attrs.ints[2 + sweep]);
  const auto& yields = in.graph.region(in.regions[sweep]).yields;
  const size_t skip = sweep == 0 && in.attrs.ints[1] != 0 ? 1 : 0;
  const bool last = sweep + 1 == in.regions.size();
  if (yields.size() < skip + count) return "a region yields too little";
  if (!last && yields.size() > skip + count) return "a region yields too much";
  if (skip != 0 && in.graph.value(yields[0]).type != ir::kBool)
    return "what ends a fold is bool, not " + in.graph.value(yields[0]).type.str();
  if (last && in.attrs.yields.size() < count) return "an op without results for its states";
  for (size_t k = 0; k < count; ++k) {
    const Type type = in.operand_types[2 + first + k].type;
    const auto expect = [&](const ir::ValueInfo& info) -> std::string {
      if (info.type != type) return "a state differs: " + type.str() + " and " + info.type.str();
      return expect_stretches({.type = info.type, .extent = info.extent}, domain);
    };
    for (size_t r = sweep; r < in.regions.size(); ++r) {
      const ir::ValueId param = in.graph.region(in.regions[r]).params[1 + first + k];
      if (std::string wrong = expect(in.graph.value(param)); !wrong.empty()) return wrong;
    }
    if (std::string wrong = expect(in.graph.value(yields[skip + k])); !wrong.empty()) return wrong;
    if (last && in.attrs.yields[k] != Yield::Element)
      return "the states after the last sweep are the first results, element each";
  }
  for (size_t k = count; last && k < in.attrs.yields.size(); ++k)
    if (in.attrs.yields[k] != Yield::Sum && in.attrs.yields[k] != Yield::Scatter)
      return "results of a fold that are no states are sums and scatters";
  return "";
}

InferResult infer_fold(const GraphInferInput& in) {
  const size_t sweeps = in.regions.size();
  if (sweeps == 0) return "expected at least one region";
  if (std::string wrong = expect_ints(in.attrs, 2 + sweeps); !wrong.empty()) return wrong;
  if (in.attrs.ints[0] < -1) return "a bound on the trips is a number of them, or -1";
  if (in.attrs.ints[1] != 0 && in.attrs.ints[1] != 1) return "a fold stops by a condition, 1, or does not, 0";
  size_t states = 0;
  for (size_t k = 0; k < sweeps; ++k) {
    const int64_t count = in.attrs.ints[2 + k];
    if (count < 0 || count > 1 << 20) return "a sweep has a number of states";
    states += static_cast<size_t>(count);
    if (in.graph.region(in.regions[k]).params.size() != 1 + states)
      return "a region has as parameters the trip and the states of its sweep and of those before it";
    if (in.graph.value(in.graph.region(in.regions[k]).params[0]).type != ir::kInt) return "a trip is an int";
  }
  if (in.operands.size() != 2 + states) return "expected two bounds and what each state starts with";
  for (size_t k = 0; k < 2; ++k)
    if (in.operand_types[k].type != ir::kInt) return "a bound is int, not " + in.operand_types[k].type.str();
  if (in.attrs.dims.size() < 3) return "expected at least 3 dims, found " + std::to_string(in.attrs.dims.size());
  size_t first = 0;
  for (size_t k = 0; k < sweeps; ++k) {
    if (std::string wrong = expect_states(in, k, first, extent_of(in.attrs)); !wrong.empty()) return wrong;
    first += static_cast<size_t>(in.attrs.ints[2 + k]);
  }
  return infer_yields(in, in.regions.last(1), sweeps == 1 && in.attrs.ints[1] != 0 ? 1 : 0);
}

}  // namespace

std::vector<OpInfo> region_ops() {
  return {
      {.kind = OpKind::If,
       .shape = Shape::Region,
       .doc = "One of two regions, chosen for each element; the other is not run.",
       .zero = ZeroWhere::BranchesAre,
       .reads = Reads::AtElement,
       .runs_as = RunsAs::Map,
       .no_gradient = "the condition of $ has no derivative",
       .infer_in_graph = infer_if},
      {.kind = OpKind::Reduce,
       .shape = Shape::Region,
       .doc = "A region run for each number of a range, its results combined.",
       .reads = Reads::AtElement,
       .runs_as = RunsAs::Map,
       .no_gradient = "the range of $ is made of integers, which have no derivative",
       .infer_in_graph = infer_reduce},
      {.kind = OpKind::Fold,
       .shape = Shape::Region,
       .doc = "A region run for each number of a range with the states that it gave before; regions after it go back "
              "and forth "
              "over its trips.",
       .reads = Reads::AtElement,
       .runs_as = RunsAs::Map,
       .no_gradient = "the range of $ is made of integers, which have no derivative",
       .infer_in_graph = infer_fold},
  };
}

}  // namespace dr::ops
