// SPDX-License-Identifier: Apache-2.0
// The inside of the pass `differentiate`: the reverse sweep of one Grad op. differentiate.cpp walks ops by the op
// table; each structured construct has a file of its own; differentiate_region.cpp holds what they share.
//
// A sweep reads a frozen *source* graph, which holds everything before the Grad op, and appends to a builder that holds
// the same. Adjoints are filed under the source's ids; `now` says what a source value is in the builder. A region's
// adjoint replays the region's ops beside it, so a value inside a region has a different id in each that replays it.
#pragma once

#include <map>
#include <span>
#include <vector>

#include "compiler/ir/graph.h"
#include "compiler/passes/passes.h"

namespace dr::passes {

// A term of the adjoint of a root image that a region reads with Gather: it is scattered to where it was read.
struct ScatterTerm {
  ir::ValueId image;  // source
  ir::ValueId index;  // builder; invalid when `value` is an accumulation of an inner region
  ir::ValueId value;  // builder
};

// The adjoints collected at one place: in the root, or in one region under construction. Of values defined there and,
// in a region, of values it captures; those leave it as results of the region's op.
struct Frame {
  bool root = false;
  ir::Extent domain;                                            // of a region: how often it runs
  std::map<ir::ValueId, ir::ValueId> adjoints;                  // source -> builder
  std::map<ir::ValueId, std::vector<ir::ValueId>> accumulated;  // adjoints of accumulations: root images, to be added
  std::vector<ScatterTerm> scatters;                            // never in the root
};

// Whether a value is the constant zero.
bool is_zero(const ir::Graph& graph, ir::ValueId id);

struct Sweep {
  const ir::Graph& source;
  ir::Builder& builder;
  ir::ValueMap now;          // source -> builder
  std::vector<bool> active;  // source values that depend on a target in a differentiable way, inside regions too
  const Skips& skips;

  // Adds a term to a source value's adjoint; drops it when nobody asked or when it is the constant zero.
  void add(Frame& frame, ir::ValueId value, ir::ValueId term);
  // Goes through ops backwards, from the adjoints of their results to those of their operands.
  void run(Frame& frame, std::span<const ir::OpId> ops);
};

// The adjoint of an If, Reduce or Fold op, from the adjoints of its results in `frame`.
void differentiate_if(Sweep& sweep, Frame& frame, ir::OpId id);
void differentiate_reduce(Sweep& sweep, Frame& frame, ir::OpId id);
void differentiate_fold(Sweep& sweep, Frame& frame, ir::OpId id);

// The adjoint of a Vjp op: the adjoints it names, with the adjoint of its result in place of the cotangent.
void differentiate_vjp(Sweep& sweep, Frame& frame, const ir::Op& op);
// The graph with each Vjp op replaced by its value, and without what depends on cotangents.
ir::Graph drop_vjps(ir::Graph graph);

// --- shared by the structured constructs ---

// The adjoint of one result of a region op, in the builder.
struct ResultAdjoint {
  ir::ValueId element;              // of a result that has one number an element; invalid: none
  std::vector<ir::ValueId> images;  // of a Scatter result: root images of its extent, to be added; empty: none
  bool any() const { return element.valid() || !images.empty(); }
};
std::vector<ResultAdjoint> result_adjoints(Sweep& sweep, const Frame& frame, const ir::Op& op);
bool any(std::span<const ResultAdjoint> adjoints);

// The elements over which the adjoint of `op` runs. Inside a region that is always the region's own domain: the op's
// may be smaller where it broadcasts, but the adjoints that reach it vary over all of it.
ir::Extent adjoint_domain(const Frame& frame, const ir::Op& op);

// Replays in the builder's current region the ops of `region` that the values (yields of it) need.
void replay(Sweep& sweep, ir::RegionId region, std::span<const ir::ValueId> values);
// Replays what the results with an adjoint need and runs the reverse sweep over it into `frame`, the current region's.
void reverse(Sweep& sweep, Frame& frame, const ir::Op& op, ir::RegionId region,
             std::span<const ResultAdjoint> adjoints);

// Yields what a trip's adjoint adds to captured values, `captured`, and scatters to root images, `images`, as collect()
// files it. Those of values that the regions `own` define stay.
void yield_captured(const Sweep& sweep, const Frame& frame, std::span<const ir::RegionId> own, ir::Attrs& attrs,
                    std::vector<ir::ValueId>& yields, std::vector<ir::ValueId>& captured,
                    std::vector<ir::ValueId>& images);
// The extents of Scatter results for attrs.dims, behind the domain.
void append_extent(ir::Attrs& attrs, const ir::Extent& extent);
// Files the results of an adjoint region op: first one for each captured value, in order, then one for each image.
void collect(Sweep& sweep, Frame& outer, std::span<const ir::ValueId> captured, std::span<const ir::ValueId> images,
             std::span<const ir::ValueId> results);

}  // namespace dr::passes
