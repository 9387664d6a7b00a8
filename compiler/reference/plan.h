// SPDX-License-Identifier: Apache-2.0
// A region op prepared for evaluation: values have numbered slots, operands know where they come from, and what
// scatters inside nested regions knows into which of the outermost op's results it adds.
#pragma once

#include <cstdint>
#include <vector>

#include "compiler/ir/graph.h"

namespace dr::reference {

struct Slot {
  enum class Source : uint8_t {
    Made,    // by an op of the region, or given as a parameter
    Parent,  // captured from the enclosing region
    Root,    // captured from the root
  };
  ir::ValueId value;
  ir::Type type;
  Source source = Source::Made;
  uint32_t parent_slot = 0;  // of Parent
};

// How one result of a region op comes from what the region yields.
struct YieldPlan {
  ir::Yield how = ir::Yield::Element;
  bool forwarded = false;       // a Scatter that yields an inner op's accumulation, which has its sinks already
  uint32_t index = 0;           // slot, of a Scatter that is not forwarded
  uint32_t value = 0;           // slot, unless forwarded
  std::vector<uint32_t> sinks;  // of a Scatter: results of the outermost op, counting its Scatter results
};

struct OpPlan;

struct Plan {
  std::vector<Slot> slots;
  std::vector<uint32_t> params;  // slots
  std::vector<OpPlan> ops;       // those that the yields need
  std::vector<YieldPlan> yields;
};

struct OpPlan {
  const ir::Op* op = nullptr;
  std::vector<uint32_t> operands;  // slots
  std::vector<uint32_t> results;   // slots
  std::vector<uint32_t> dead;      // slots of values whose last use this is
  std::vector<Plan> regions;
};

// One region op of the root: its operands and results are the slots of a plan with just this op.
Plan plan_op(const ir::Graph& graph, const ir::Op& op);
// The regions of a Raster op, each with all its parameters as slots; yields are Elements.
Plan plan_raster_region(const ir::Graph& graph, ir::RegionId region);

}  // namespace dr::reference
