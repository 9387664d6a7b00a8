// SPDX-License-Identifier: Apache-2.0
// Raster: which faces does a pixel see. Integers only, so nothing flows back through it.
//
//   attrs.ints = {K, fields, corners}      corners is 3 or 6; with a fourth number, 1, faces are listed, or, 2, their
//   order is given attrs.dims = {W, H, L, F}              the domain, then the number of faces operands   = field 0 ..
//   fields-1       any type, extent [F, 1, L] or what broadcasts to it: the record of `setup`
//                corner 0 .. corners-1     vec2, likewise, in pixels
//                cull                      bool, likewise
//   regions    = depth, keep, tag          each with parameters (field 0, .., field n-1, p : vec2), yielding
//                                          one float, one bool, one int; they capture values that broadcast to
//                                          [W, H, L]
//   results    = face 0, tag 0, .., face K-1, tag K-1     int[W, H, L]; -1 and 0 where there is none
//                where their order is given, face 0, tag 0, order 0, ..: 2^24 - 1 where there is none
//                where faces are listed, 16 * face + tag of all ranks, or -1: int[W, H, K * L], those of rank k in
//                layers from k * L on
//
// For pixel (x, y, l) the candidates are the faces that `cull` spares and whose `keep` holds at p = (x + 0.5, y + 0.5);
// a face with a NaN among its corners has none, and any whose depth is NaN is dropped. They are ordered by
// (order, face), where order is floor(clamp(depth, 0, 1) * (2^24 - 1)). `keep` must imply that p lies in the hull of
// the corners (of either triangle): lowerings enumerate candidates by it.
//
// Listed faces are ordered by number alone, and there are fewer than 2^27: `depth` is not called.
#include "compiler/ir/raster.h"

#include "compiler/ops/families.h"
#include "compiler/ops/rules.h"

namespace dr::ops {

using namespace rules;

namespace {

InferResult infer_raster(const GraphInferInput& in) {
  const bool listed = ir::lists_faces(in.attrs);
  const size_t each = ir::results_a_rank(in.attrs);
  if (std::string wrong = expect_ints(in.attrs, listed || each == 3 ? 4 : 3); !wrong.empty()) return wrong;
  if (std::string wrong = expect_dims(in.attrs, 4); !wrong.empty()) return wrong;
  const int64_t nearest = in.attrs.ints[0], fields = in.attrs.ints[1], corners = in.attrs.ints[2];
  if (nearest < 1) return "a pixel has at least one result";
  if (corners != 3 && corners != 6) return "a hull is one triangle or two, of 3 or 6 corners";
  if (fields < 0 || in.operands.size() != static_cast<size_t>(fields) + static_cast<size_t>(corners) + 1) {
    return "expected fields, corners and cull, found " + std::to_string(in.operands.size()) + " operands";
  }
  if (in.regions.size() != 3) return "expected three regions: depth, keep, tag";

  const Extent pixels = extent_of(in.attrs);
  const Extent faces{in.attrs.dims[3], 1, pixels.l};
  for (size_t k = 0; k < in.operand_types.size(); ++k) {
    const ResultType& operand = in.operand_types[k];
    if (!stretches_to(operand.extent, faces)) return words(operand) + " does not stretch to the faces, " + faces.str();
    if (k < static_cast<size_t>(fields)) continue;
    const Type wanted = k + 1 < in.operand_types.size() ? ir::vec(2) : ir::kBool;
    if (operand.type != wanted) return "expected " + wanted.str() + ", found " + operand.type.str();
  }

  const Type yields[] = {ir::kFloat, ir::kBool, ir::kInt};
  for (size_t r = 0; r < 3; ++r) {
    const ir::Region& region = in.graph.region(in.regions[r]);
    if (region.params.size() != static_cast<size_t>(fields) + 1)
      return "a region has the fields and the point as parameters";
    for (size_t k = 0; k < region.params.size(); ++k) {
      const Type wanted = k < static_cast<size_t>(fields) ? in.operand_types[k].type : ir::vec(2);
      const Type found = in.graph.value(region.params[k]).type;
      if (found != wanted) return "a parameter is " + found.str() + " and should be " + wanted.str();
    }
    if (region.yields.size() != 1) return "a region yields one value";
    const ir::ValueInfo& yield = in.graph.value(region.yields[0]);
    if (yield.type != yields[r]) return "expected a region to yield " + yields[r].str() + ", found " + yield.type.str();
    if (!stretches_to(yield.extent, pixels))
      return "a region yields " + yield.type.str() + yield.extent.str() + ", which does not stretch to the domain";
  }
  if (listed) return one(ir::kInt, {pixels.w, pixels.h, pixels.l * ir::Dim(nearest)});
  return std::vector<ResultType>(each * static_cast<size_t>(nearest), {.type = ir::kInt, .extent = pixels});
}

}  // namespace

std::vector<OpInfo> raster_ops() {
  return {
      {.kind = OpKind::Raster,
       .shape = Shape::Region,
       .doc = "Which faces a pixel sees, nearest first, as numbers. No derivative.",
       .reads = Reads::PerFace,
       .runs_as = RunsAs::Raster,
       .no_gradient = "$ gives faces, tags and orders, and integers have no derivative",
       .infer_in_graph = infer_raster,
       .differentiable = false},
  };
}

}  // namespace dr::ops
