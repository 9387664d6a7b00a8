// SPDX-License-Identifier: Apache-2.0
// The op table: the families' entries, indexed by kind. It is put together, and checked to be complete, when it is
// first used.
#include "compiler/ops/op.h"

#include "compiler/ops/families.h"

namespace dr::ops {

namespace {

void check_entry(const OpInfo& info) {
  const auto require = [&](bool holds, const char* what) {
    if (!holds) DR_ICE("the entry of op '" + std::string(ir::op_name(info.kind)) + "' lacks " + what);
  };
  require(!info.doc.empty(), "a doc line");
  require((info.infer != nullptr) != (info.infer_in_graph != nullptr), "its one type rule");
  if (info.shape == Shape::Elementwise) {
    require(info.eval != nullptr, "its evaluation");
    require(info.glsl != nullptr, "its GLSL");
  }
  if (info.shape == Shape::Image || info.shape == Shape::Region) {
    require(info.reads.has_value(), "where it reads its operands");
    require(info.runs_as.has_value(), "the kind of pass that computes it");
  }
  if (info.shape == Shape::Elementwise || info.shape == Shape::Image) {
    require((info.adjoint != nullptr) == info.differentiable, "either an adjoint or the word that it has none");
  }
}

std::vector<OpInfo> build_table() {
  std::vector<OpInfo> table(ir::all_op_kinds().size(), OpInfo{.kind = {}, .shape = {}, .doc = {}});
  for (const Family& family : families()) {
    for (OpInfo& entry : family.entries()) {
      OpInfo& place = table[static_cast<size_t>(entry.kind)];
      if (!place.doc.empty()) DR_ICE("op '" + std::string(ir::op_name(entry.kind)) + "' has two entries");
      check_entry(entry);
      place = std::move(entry);
    }
  }
  for (size_t i = 0; i < table.size(); ++i) {
    if (table[i].doc.empty()) DR_ICE("op '" + std::string(ir::op_name(static_cast<ir::OpKind>(i))) + "' has no entry");
  }
  return table;
}

}  // namespace

std::span<const Family> families() {
  static constexpr Family kFamilies[] = {
      {"Sources", source_ops},
      {"Arithmetic, component by component", arithmetic_ops},
      {"Float functions, component by component", math_ops},
      {"Integers and bits, component by component", integer_ops},
      {"Comparison, logic, choice, conversion", logic_ops},
      {"Vectors and matrices", vector_ops},
      {"Images", image_ops},
      {"Regions", region_ops},
      {"Rasterization", raster_ops},
      {"Gradients and barriers", gradient_ops},
  };
  return kFamilies;
}

const OpInfo& info(ir::OpKind kind) {
  static const std::vector<OpInfo> table = build_table();
  return table[static_cast<size_t>(kind)];
}

std::vector<std::string_view> prelude(const OpInfo& info, const GlslInput& input) {
  if (info.prelude_of != nullptr) return info.prelude_of(input);
  std::vector<std::string_view> texts = info.prelude;
  if (!info.vector_prelude.empty() && !input.result_type.is_scalar()) texts.push_back(info.vector_prelude);
  return texts;
}

InferResult infer(const ir::Graph& graph, ir::OpKind kind, std::span<const ir::ValueId> operands,
                  const ir::Attrs& attrs, std::span<const ir::RegionId> regions, std::optional<ir::Type> written) {
  const OpInfo& entry = info(kind);
  std::vector<ir::ResultType> types;
  types.reserve(operands.size());
  for (const ir::ValueId id : operands) {
    const ir::ValueInfo& value = graph.value(id);
    types.push_back({.type = value.type, .extent = value.extent, .accumulation = value.accumulation});
  }
  if (entry.infer_in_graph != nullptr) {
    return entry.infer_in_graph({.graph = graph,
                                 .operands = operands,
                                 .operand_types = types,
                                 .attrs = attrs,
                                 .regions = regions,
                                 .written = written});
  }
  if (!regions.empty()) return "this op has no regions";
  return entry.infer({.operands = types, .attrs = attrs});
}

}  // namespace dr::ops
